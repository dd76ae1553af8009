"""All materials by name: what each is made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from workshop.render.surfaces.shader import Color, Shader, Socket

RECIPES: dict[str, Callable[[Shader], Any]] = {}


class Materials(dict):
    """Blender materials by name, made when first asked for."""

    def __missing__(self, name: str) -> Any:
        self[name] = RECIPES[name](Shader(name))
        return self[name]


def recipe(function: Callable[[Shader], Any]) -> Callable[[Shader], Any]:
    """Register a material under its function's name."""
    RECIPES[function.__name__] = function
    return function


# The ground


@recipe
def asphalt(s: Shader) -> Any:
    """Stones of many grays in tar, oil stains, patches of other age, cracks."""
    grays = (0.05, 0.05, 0.052), (0.16, 0.155, 0.15)
    stones = s.mix(s.ramp(s.cells(45.0, output="Color"), 0.1, 0.9), *grays)
    other_age = s.shade(stones, 0.45, 0.75, s.noise(0.9, 4))
    patches = s.mix(s.ramp(s.noise(0.13, 2), 0.42, 0.62), stones, other_age)
    stains = s.shade(patches, 0.55, 1.25, s.ramp(s.noise(1.7, 6, 0.65), 0.3, 0.7))
    noise = s.node("TexNoise", Vector=s.position, Scale=2.0).outputs["Color"]
    wobble = s.mix(0.08, s.position, noise)
    crack = s.ramp(s.cells(0.22, "DISTANCE_TO_EDGE", at=wobble), 0.002, 0.006)
    return s.finish(s.shade(stains, 0.35, 1.0, crack), (0.09, 0.088, 0.085))


@recipe
def paint_white(s: Shader) -> Any:
    """Road paint, worn through in places."""
    worn = s.ramp(s.noise(7.0, 6, 0.7), 0.34, 0.44)
    grime = s.shade((0.72, 0.72, 0.69), 0.6, 1.05, s.noise(2.5, 5))
    return s.finish(s.mix(worn, (0.16, 0.155, 0.15), grime), (0.6, 0.6, 0.58))


@recipe
def slabs(s: Shader) -> Any:
    """Pavement slabs of differing gray, chewing gum, stains in large patches."""
    colors = (0.42, 0.4, 0.37), (0.26, 0.26, 0.26), (0.07, 0.065, 0.06)
    grays = s.bricks(colors, 0.6, 0.4, 0.008, s.position)
    speckled = s.shade(grays, 0.7, 1.25, s.noise(28.0, 4, 0.7))
    gum = s.ramp(s.cells(2.3), 0.045, 0.06)
    stained = s.shade(speckled, 0.55, 1.2, s.ramp(s.noise(0.7, 6, 0.65), 0.28, 0.72))
    return s.finish(s.shade(stained, 0.45, 1.0, gum), (0.3, 0.29, 0.27))


@recipe
def cobbles(s: Shader) -> Any:
    """Small paving stones of warm colours."""
    colors = (0.3, 0.2, 0.15), (0.16, 0.13, 0.12), (0.05, 0.045, 0.04)
    stones = s.bricks(colors, 0.22, 0.11, 0.007, s.position)
    speckled = s.shade(stones, 0.6, 1.3, s.noise(22.0, 4))
    return s.finish(s.shade(speckled, 0.6, 1.2, s.noise(0.6, 5)), (0.2, 0.16, 0.13))


@recipe
def kerbstone(s: Shader) -> Any:
    """Granite blocks."""
    blocks = s.bricks(((0.5, 0.49, 0.47), (0.34, 0.34, 0.34), (0.08, 0.08, 0.08)), 1.0, 2.0, 0.012)
    return s.finish(s.shade(blocks, 0.55, 1.3, s.noise(60.0, 4, 0.8)), (0.4, 0.39, 0.38))


@recipe
def iron_lid(s: Shader) -> Any:
    """A manhole cover: raised squares in cast iron."""
    colors = (0.2, 0.19, 0.18), (0.15, 0.15, 0.15), (0.04, 0.04, 0.04)
    squares = s.bricks(colors, 0.06, 0.06, 0.014, s.position, 0.0)
    return s.finish(s.shade(squares, 0.6, 1.2, s.noise(9.0, 4)), (0.13, 0.13, 0.13), 0.3, 0.4)


@recipe
def grass(s: Shader) -> Any:
    """A lawn with clumps, dry patches and flowers."""
    blades = s.mix(s.noise(40.0, 4, 0.75), (0.03, 0.09, 0.012), (0.2, 0.3, 0.06))
    dry = s.mix(s.ramp(s.noise(0.5, 5), 0.45, 0.7), blades, (0.3, 0.26, 0.1))
    flowers = s.ramp(s.cells(5.0), 0.05, 0.09)
    return s.finish(s.mix(flowers, (0.8, 0.75, 0.4), dry), (0.12, 0.17, 0.05))


@recipe
def soil(s: Shader) -> Any:
    """Bare earth with bark mulch."""
    mulch = s.mix(s.cells(30.0, output="Color"), (0.05, 0.03, 0.02), (0.28, 0.18, 0.1))
    return s.finish(mulch, (0.13, 0.09, 0.06))


# Walls; the object's colour is the building's own


def _weather(s: Shader, color: Socket) -> Socket:
    """Darken towards the street, with vertical streaks of rain and blotches of soot."""
    streaks = s.ramp(s.noise(1.6, 4, 0.6, s.stretch(s.position, (1.0, 1.0, 0.08))), 0.35, 0.7)
    streaked = s.shade(color, 1.12, 0.72, streaks)
    blotched = s.shade(streaked, 0.72, 1.2, s.noise(0.35, 6, 0.65))
    splash = s.math("ADD", s.ramp(s.height, 0.1, 1.6), s.math("SUBTRACT", s.noise(1.8, 4), 0.5))
    return s.shade(blotched, 0.55, 1.0, s.ramp(splash, 0.0, 1.0))


@recipe
def brick(s: Shader) -> Any:
    """Bricks in running bond, every one with its own shade."""
    dark = s.shade(s.tint, 0.5, 0.75, s.noise(0.8, 2))
    wall = s.bricks((s.tint, dark, (0.36, 0.34, 0.31)), 0.25, 0.0833, 0.006)
    return s.finish(_weather(s, s.shade(wall, 0.6, 1.35, s.noise(14.0, 5, 0.75))), s.tint)


@recipe
def plaster(s: Shader) -> Any:
    """Painted render: grain, trowel marks, repairs, hairline cracks."""
    grain = s.shade(s.tint, 0.72, 1.22, s.noise(26.0, 5, 0.8))
    repair = s.shade(grain, 0.78, 0.95, s.noise(5.0, 3))
    repaired = s.mix(s.ramp(s.noise(0.28, 2), 0.6, 0.64), grain, repair)
    crack = s.ramp(s.cells(0.35, "DISTANCE_TO_EDGE"), 0.001, 0.006)
    return s.finish(_weather(s, s.shade(repaired, 0.6, 1.0, crack)), s.tint)


@recipe
def concrete(s: Shader) -> Any:
    """Cast panels with joints, tie holes and clouds of gray."""
    colors = s.tint, s.shade(s.tint, 0.8, 0.95, 0.5), (0.09, 0.09, 0.09)
    panels = s.bricks(colors, 1.8, 1.5, 0.014, shift=0.0)
    clouds = s.shade(panels, 0.65, 1.25, s.noise(2.4, 8, 0.7))
    holes = s.ramp(s.cells(1.6, at=s.wall), 0.03, 0.045)
    return s.finish(_weather(s, s.shade(clouds, 0.35, 1.0, holes)), s.tint)


@recipe
def stone(s: Shader) -> Any:
    """Ashlar blocks of limestone or sandstone."""
    colors = s.tint, s.shade(s.tint, 0.66, 0.8, 0.5), (0.16, 0.14, 0.12)
    blocks = s.bricks(colors, 0.85, 0.38, 0.011)
    return s.finish(_weather(s, s.shade(blocks, 0.62, 1.28, s.noise(8.0, 7, 0.72))), s.tint)


@recipe
def tiles(s: Shader) -> Any:
    """Small glazed tiles."""
    colors = s.tint, s.shade(s.tint, 0.6, 0.85, s.noise(1.2, 2)), (0.5, 0.5, 0.48)
    pattern = s.shade(s.bricks(colors, 0.2, 0.1, 0.006, shift=0.0), 0.75, 1.2, s.noise(6.0, 4))
    return s.finish(_weather(s, pattern), s.tint, 0.35, 0.25)


@recipe
def cladding(s: Shader) -> Any:
    """Upright metal sheets, ribbed, scratched."""
    colors = s.tint, s.shade(s.tint, 0.75, 0.95, 0.5), s.shade(s.tint, 0.3, 0.4, 0.5)
    ribs = s.shade(s.bricks(colors, 0.6, 2.6, 0.014), 0.75, 1.2, s.noise(5.0, 7, 0.75))
    return s.finish(_weather(s, ribs), s.tint, 0.25, 0.4)


@recipe
def trim(s: Shader) -> Any:
    """Window frames, cornices, sills: light paint or stone."""
    paint = s.mix(0.3, (0.72, 0.69, 0.63), s.tint)
    return s.finish(s.shade(paint, 0.6, 1.1, s.noise(9.0, 6, 0.7)), (0.6, 0.58, 0.53))


@recipe
def roof(s: Shader) -> Any:
    """Gravel and tar felt."""
    gravel = s.mix(s.cells(18.0, output="Color"), (0.13, 0.12, 0.11), (0.33, 0.31, 0.28))
    return s.finish(s.shade(gravel, 0.6, 1.2, s.noise(0.5, 5)), (0.22, 0.21, 0.19))


@recipe
def roof_tiles(s: Shader) -> Any:
    """Clay tiles on pitched roofs."""
    rows = s.bricks(((0.36, 0.13, 0.07), (0.24, 0.09, 0.06), (0.06, 0.03, 0.02)), 0.24, 0.2, 0.02)
    return s.finish(s.shade(rows, 0.6, 1.3, s.noise(1.4, 6, 0.7)), (0.28, 0.11, 0.07))


# Glass: the room behind is painted on, the street before it is mirrored


@recipe
def window(s: Shader) -> Any:
    """A pane: dark room, blind or curtain, chosen by the face's value, under a mirror."""
    folds = s.noise(3.0, 3, 0.6, s.stretch(s.wall, (4.0, 0.3, 0.0)))
    curtain = s.shade((0.6, 0.55, 0.46), 0.35, 1.1, folds)
    slats = s.math("GREATER_THAN", s.math("FRACT", s.math("MULTIPLY", s.height, 14.0)), 0.35)
    blind = s.shade((0.58, 0.57, 0.54), 0.45, 1.0, slats)
    room = s.mix(s.cells(1.3, output="Color", at=s.wall), (0.012, 0.014, 0.016), (0.12, 0.09, 0.06))
    kind = s.math("GREATER_THAN", s.value, 0.55)
    inside = s.mix(kind, room, curtain)
    inside = s.mix(s.math("GREATER_THAN", s.value, 0.82), inside, blind)
    return s.finish(s.shade(inside, 0.75, 1.1, s.noise(6.0, 4)), (0.12, 0.13, 0.14), 0.52, 0.02)


@recipe
def curtain_wall(s: Shader) -> Any:
    """Tinted office glass."""
    deep = s.shade(s.mix(0.6, (0.02, 0.03, 0.035), s.tint), 0.4, 1.3, s.value)
    return s.finish(s.shade(deep, 0.7, 1.2, s.noise(1.1, 5)), (0.06, 0.07, 0.08), 0.8, 0.03)


@recipe
def shop_window(s: Shader) -> Any:
    """Goods on shelves behind clean glass."""
    colors = [s.cells(scale, output="Color", at=s.wall) for scale in (4.7, 9.1)]
    goods = s.bricks((*colors, (0.03, 0.025, 0.02)), 0.34, 0.42, 0.035)
    lit = s.shade(goods, 0.12, 0.6, s.noise(2.2, 5))
    return s.finish(lit, (0.12, 0.1, 0.09), 0.45, 0.015)


# Street furniture and vehicles: these move or repeat, so their textures sit in their own frames


@recipe
def metal(s: Shader) -> Any:
    """Galvanised steel: zinc flowers and rust drips."""
    zinc = s.mix(s.cells(14.0, output="Color"), (0.27, 0.28, 0.29), (0.42, 0.43, 0.44))
    drips = s.ramp(s.noise(3.0, 6, 0.7), 0.58, 0.7)
    return s.finish(s.mix(drips, zinc, (0.24, 0.12, 0.06)), (0.34, 0.34, 0.34), 0.3, 0.35)


@recipe
def tinted(s: Shader) -> Any:
    """Painted wood, plastic or cloth in the object's colour."""
    return s.finish(s.shade(s.tint, 0.6, 1.25, s.noise(16.0, 5, 0.7, s.local)), s.tint)


@recipe
def fabric(s: Shader) -> Any:
    """Cloth coloured by the face's value, as people wear it, with folds and weave."""
    ramp = s.node("ValToRGB", s.value)
    colors = [(0.02, 0.02, 0.03), (0.05, 0.08, 0.2), (0.3, 0.04, 0.04), (0.42, 0.38, 0.3)]
    colors += [(0.08, 0.16, 0.1), (0.5, 0.5, 0.5), (0.35, 0.2, 0.08), (0.62, 0.5, 0.1)]
    colors += [(0.1, 0.22, 0.35), (0.45, 0.1, 0.2)]
    stops = ramp.color_ramp.elements
    ramp.color_ramp.interpolation = "CONSTANT"
    for i, color in enumerate(colors):
        stop = stops[i] if i < 2 else stops.new(i / len(colors))
        stop.position, stop.color = i / len(colors), (*color, 1.0)
    folds = s.noise(5.0, 5, 0.7, s.stretch(s.local, (1.6, 1.6, 0.6)))
    return s.finish(s.shade(ramp.outputs[0], 0.45, 1.4, folds), (0.2, 0.18, 0.17))


@recipe
def skin(s: Shader) -> Any:
    """Skin of many people: the object's random number chooses."""
    color = s.mix(s.random, (0.5, 0.3, 0.21), (0.13, 0.07, 0.045))
    return s.finish(s.shade(color, 0.8, 1.1, s.noise(20.0, 3, 0.6, s.local)), (0.3, 0.19, 0.13))


@recipe
def wood(s: Shader) -> Any:
    """Planks with grain."""
    grain = s.noise(6.0, 6, 0.7, s.stretch(s.position, (6.0, 6.0, 0.5)))
    return s.finish(s.mix(grain, (0.12, 0.065, 0.03), (0.4, 0.25, 0.13)), (0.25, 0.15, 0.08))


@recipe
def bark(s: Shader) -> Any:
    """Furrowed bark."""
    furrows = s.ramp(s.noise(9.0, 6, 0.75, s.stretch(s.local, (3.0, 3.0, 0.5))), 0.3, 0.7)
    return s.finish(s.mix(furrows, (0.045, 0.03, 0.02), (0.3, 0.24, 0.17)), (0.16, 0.12, 0.09))


@recipe
def leaf(s: Shader) -> Any:
    """Leaves, each with its own green."""
    green = s.mix(s.value, (0.022, 0.06, 0.008), (0.2, 0.27, 0.045))
    dryness = s.math("MULTIPLY", s.random, 0.35)
    return s.finish(s.mix(dryness, green, (0.3, 0.24, 0.03)), (0.08, 0.12, 0.025))


@recipe
def car_paint(s: Shader) -> Any:
    """Lacquer over colour, dust towards the sills."""
    uneven = s.math("SUBTRACT", s.noise(4.0, 5, 0.7, s.local), 0.75)
    dust = s.math("ADD", s.ramp(s.split(s.local)[2], 0.75, 0.2), uneven)
    return s.finish(s.mix(s.ramp(dust, 0.0, 1.0), s.tint, (0.28, 0.25, 0.21)), s.tint, 0.42, 0.08)


@recipe
def car_glass(s: Shader) -> Any:
    """Dark car windows with a hint of seats."""
    seats = s.mix(s.noise(3.5, 3, 0.5, s.local), (0.006, 0.007, 0.008), (0.06, 0.055, 0.05))
    return s.finish(seats, (0.03, 0.03, 0.03), 0.5, 0.02)


@recipe
def plate(s: Shader) -> Any:
    """Number plates: dark marks on white."""
    marks = s.math("GREATER_THAN", s.cells(16.0, output="Color", at=s.local), 0.6)
    return s.finish(s.shade((0.7, 0.7, 0.66), 0.1, 1.0, marks), (0.5, 0.5, 0.48))


@recipe
def poster(s: Shader) -> Any:
    """Pasted paper: blocks of colour and lines of print."""
    blocks = s.cells(2.2, output="Color", at=s.wall)
    lines = s.bricks(((0.7, 0.68, 0.6), blocks, (0.1, 0.1, 0.12)), 0.5, 0.16, 0.02)
    print_ = s.shade(s.mix(0.5, lines, blocks), 0.5, 1.05, s.noise(6.0, 6, 0.7))
    return s.finish(print_, (0.4, 0.38, 0.36))


@recipe
def skyline(s: Shader) -> Any:
    """Far buildings: rows of windows painted on."""
    colors = (0.05, 0.06, 0.075), (0.16, 0.17, 0.18), s.tint
    rows = s.bricks(colors, 2.6, 3.2, 0.9, shift=0.0)
    return s.finish(s.shade(rows, 0.7, 1.2, s.noise(0.4, 5)), s.tint)


# Rooms and furniture


def _by_value(s: Shader, far: float) -> Socket:
    """Return the place in the object's frame, moved by the face's value times `far`."""
    return s.node("VectorMath", s.local, s.join(s.math("MULTIPLY", s.value, far), 0.0)).outputs[0]


@recipe
def wall_paint(s: Shader) -> Any:
    """Emulsion paint on plaster: a faint grain, fainter clouds. The face's value is the colour."""
    color = s.mix(s.value, (0.72, 0.69, 0.62), (0.42, 0.52, 0.5))
    grained = s.shade(color, 0.93, 1.05, s.noise(55.0, 4, 0.7))
    return s.finish(s.shade(grained, 0.95, 1.03, s.noise(1.1, 3)), color)


@recipe
def parquet(s: Shader) -> Any:
    """Oak boards along x, each with its own brown, varnished."""
    colors = (0.4, 0.24, 0.12), (0.27, 0.15, 0.075), (0.05, 0.03, 0.02)
    boards = s.bricks(colors, 1.4, 0.13, 0.0025, s.position, 0.37)
    grain = s.noise(7.0, 6, 0.7, s.stretch(s.position, (0.8, 9.0, 1.0)))
    return s.finish(s.shade(boards, 0.72, 1.25, grain), (0.33, 0.2, 0.1), 0.3, 0.28)


@recipe
def oak(s: Shader) -> Any:
    """Oiled wood, light or dark by the face's value."""
    color = s.mix(s.value, (0.2, 0.11, 0.055), (0.5, 0.33, 0.17))
    grain = s.noise(9.0, 6, 0.7, s.stretch(s.local, (6.0, 0.9, 1.4)))
    return s.finish(s.shade(color, 0.68, 1.25, grain), (0.35, 0.22, 0.11), 0.2, 0.35)


@recipe
def book(s: Shader) -> Any:
    """Cloth and paper spines, a colour for each face value, with bands for title and author."""
    own = s.join(s.math("MULTIPLY", s.value, 613.0), 0.0)
    dye = s.shade(s.cells(1.0, output="Color", at=own), 0.35, 0.75, s.value)
    color = s.mix(0.5, dye, s.mix(s.value, (0.3, 0.26, 0.2), (0.04, 0.035, 0.03)))
    cloth = s.shade(color, 0.5, 0.95, s.noise(30.0, 4))
    bands = s.noise(1.0, 2, 0.5, s.join(s.math("MULTIPLY", s.height, 42.0), own))
    return s.finish(s.mix(s.ramp(bands, 0.6, 0.64), cloth, (0.6, 0.55, 0.4)), (0.2, 0.16, 0.13))


@recipe
def glaze(s: Shader) -> Any:
    """Glazed earthenware, from sea green to clay by the face's value, speckled."""
    color = s.mix(s.value, (0.1, 0.22, 0.24), (0.55, 0.36, 0.22))
    speckled = s.shade(color, 0.6, 1.2, s.noise(24.0, 5, 0.7, s.local))
    return s.finish(speckled, (0.3, 0.27, 0.22), 0.4, 0.12)


@recipe
def screen(s: Shader) -> Any:
    """Dark glass of a display that is off."""
    return s.finish((0.012, 0.013, 0.015), (0.012, 0.013, 0.015), 0.35, 0.12)


@recipe
def magazine(s: Shader) -> Any:
    """Pages of photographs and columns of text; the face's value turns the leaf."""
    at = _by_value(s, 31.0)
    photo = s.cells(14.0, output="Color", at=at)
    colors = (0.62, 0.61, 0.57), (0.62, 0.61, 0.57), (0.16, 0.16, 0.16)
    text = s.bricks(colors, 0.06, 0.009, 0.002, at)
    picture = s.math("GREATER_THAN", s.noise(5.0, 1, 0.5, at), 0.52)
    return s.finish(s.mix(picture, text, photo), (0.45, 0.44, 0.42), 0.15, 0.3)


@recipe
def fruit(s: Shader) -> Any:
    """Apples and oranges by the face's value."""
    color = s.mix(s.math("GREATER_THAN", s.value, 0.5), (0.5, 0.07, 0.03), (0.7, 0.33, 0.04))
    speckled = s.shade(color, 0.7, 1.25, s.noise(30.0, 4, 0.6, s.local))
    return s.finish(speckled, (0.55, 0.2, 0.05), 0.3, 0.25)


@recipe
def upholstery(s: Shader) -> Any:
    """Grey-blue wool: weave and wear."""
    wool = (0.17, 0.21, 0.26)
    weave = s.shade(wool, 0.65, 1.35, s.noise(160.0, 2, 0.6, s.local))
    return s.finish(s.shade(weave, 0.75, 1.2, s.noise(4.0, 4, 0.6, s.local)), wool)


@recipe
def rug(s: Shader) -> Any:
    """Nested lozenges in wool; the face's value shifts their colours."""
    x, y, z = s.split(s.local)
    across = s.math("PINGPONG", s.math("ADD", x, z), 0.16)
    ring = s.math("ADD", s.math("MULTIPLY", s.math("PINGPONG", y, 0.1), 1.6), across)
    warm = s.mix(s.value, (0.36, 0.08, 0.055), (0.5, 0.32, 0.1))
    inner = s.mix(s.math("GREATER_THAN", ring, 0.09), (0.08, 0.12, 0.18), (0.5, 0.43, 0.32))
    lozenges = s.mix(s.math("GREATER_THAN", ring, 0.13), inner, warm)
    outer = s.mix(s.math("GREATER_THAN", ring, 0.24), lozenges, (0.1, 0.13, 0.16))
    wool = s.noise(130.0, 2, 0.6, s.local)
    return s.finish(s.shade(outer, 0.65, 1.25, wool), (0.28, 0.16, 0.11))


@recipe
def curtain(s: Shader) -> Any:
    """Linen, from sand to ochre by the face's value."""
    color = s.mix(s.value, (0.4, 0.24, 0.1), (0.6, 0.53, 0.41))
    threads = s.noise(60.0, 3, 0.6, s.stretch(s.local, (1.0, 3.0, 0.3)))
    return s.finish(s.shade(color, 0.75, 1.15, threads), (0.5, 0.43, 0.32))


@recipe
def wicker(s: Shader) -> Any:
    """Woven willow."""
    colors = (0.42, 0.28, 0.14), (0.27, 0.16, 0.08), (0.05, 0.03, 0.02)
    rows = s.bricks(colors, 0.045, 0.016, 0.003)
    return s.finish(s.shade(rows, 0.6, 1.25, s.noise(30.0, 4)), (0.3, 0.19, 0.1))


@recipe
def canvas(s: Shader) -> Any:
    """Painted shapes in the colours of sea and fields, another one for each face value."""
    at = _by_value(s, 77.0)
    shapes = s.mix(s.ramp(s.noise(3.2, 3, 0.5, at), 0.46, 0.5), (0.08, 0.2, 0.28), (0.62, 0.5, 0.3))
    strokes = s.mix(s.ramp(s.noise(6.5, 4, 0.6, at), 0.56, 0.6), shapes, (0.5, 0.15, 0.08))
    return s.finish(s.shade(strokes, 0.6, 1.2, s.noise(40.0, 5, 0.7)), (0.33, 0.28, 0.22))


# Plain colours, speckled: colour, darkest and lightest factor on it, the noise between them (lumps
# in a metre, detail, roughness), whether it moves with the object; the colour in indirect light,
# gloss and roughness.
_SPECKLED = {
    # frames, railings; old enamel on benches, bins and posts; tyres, plastic; wheels, bright metal
    "dark_trim": (
        (0.06, 0.062, 0.068),
        0.5,
        1.5,
        (11.0, 4),
        False,
        (0.06, 0.06, 0.065),
        0.35,
        0.35,
    ),
    "green_paint": ((0.03, 0.1, 0.055), 0.5, 1.6, (7.0, 6, 0.7), False, (0.04, 0.1, 0.06), 0.35),
    "rubber": ((0.022, 0.022, 0.023), 0.6, 2.2, (18.0, 4, 0.7), True, (0.025, 0.025, 0.025)),
    "rim": ((0.42, 0.42, 0.43), 0.4, 1.2, (9.0, 4), True, (0.4, 0.4, 0.4), 0.6, 0.2),
    # letters and borders of signs; signs, hydrants; lamps that are off
    "white": ((0.78, 0.77, 0.73), 0.75, 1.05, (7.0, 5), False, (0.72, 0.71, 0.68)),
    "sign_red": ((0.5, 0.02, 0.02), 0.7, 1.15, (8.0, 4), False, (0.45, 0.03, 0.03)),
    "sign_blue": ((0.02, 0.08, 0.42), 0.7, 1.2, (8.0, 4), False, (0.03, 0.09, 0.4)),
    "sign_yellow": ((0.65, 0.42, 0.02), 0.6, 1.15, (9.0, 5), False, (0.6, 0.4, 0.03)),
    "lamp_off": ((0.6, 0.58, 0.5), 0.6, 1.1, (11.0, 3), False, (0.5, 0.5, 0.45), 0.5, 0.1),
    # distemper; gloss paint on wood and iron
    "ceiling": ((0.8, 0.8, 0.78), 0.96, 1.02, (40.0, 4, 0.7), False, (0.78, 0.78, 0.76)),
    "enamel": ((0.74, 0.73, 0.7), 0.94, 1.03, (18.0, 4), False, (0.72, 0.71, 0.68), 0.25, 0.25),
}
# Traffic lights that are on, parchment with a lamp behind, frosted glass: colour and strength.
_LAMPS = {
    "lamp_red": ((1.0, 0.04, 0.02), 2.5),
    "lamp_green": ((0.05, 1.0, 0.35), 2.0),
    "lamp_shade": ((1.0, 0.82, 0.58), 0.7),
    "bulb": ((1.0, 0.92, 0.8), 1.7),
}


def _speckled(
    s: Shader, color: Color, low: float, high: float, noise: tuple, moves: bool, *finish: Any
) -> Any:
    by = s.noise(*noise, at=s.local if moves else s.position)
    return s.finish(s.shade(color, low, high, by), *finish)


RECIPES |= {name: lambda s, row=row: _speckled(s, *row) for name, row in _SPECKLED.items()}
RECIPES |= {name: lambda s, row=row: s.glow(*row) for name, row in _LAMPS.items()}
