"""All materials by name: what each is made of. They are `recipe`s of `shader`."""

from __future__ import annotations

from typing import Any

from workshop.render.surfaces.shader import Materials, Shader, Socket, recipe

__all__ = ["Materials", "Shader", "Socket", "recipe"]

# The ground


@recipe
def asphalt(s: Shader) -> Any:
    """Stones of many grays in tar, oil stains, patches of other age, cracks."""
    stones = s.mix(
        s.ramp(s.cells(45.0, output="Color"), 0.1, 0.9), (0.05, 0.05, 0.052), (0.16, 0.155, 0.15)
    )
    patches = s.mix(
        s.ramp(s.noise(0.13, 2), 0.42, 0.62), stones, s.shade(stones, 0.45, 0.75, s.noise(0.9, 4))
    )
    stains = s.shade(patches, 0.55, 1.25, s.ramp(s.noise(1.7, 6, 0.65), 0.3, 0.7))
    wobble = s.mix(
        0.08,
        s.position,
        s.node("ShaderNodeTexNoise", Vector=s.position, Scale=2.0).outputs["Color"],
    )
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
    flat = s.position
    grays = s.bricks(
        ((0.42, 0.4, 0.37), (0.26, 0.26, 0.26), (0.07, 0.065, 0.06)), 0.6, 0.4, 0.008, flat
    )
    speckled = s.shade(grays.outputs[0], 0.7, 1.25, s.noise(28.0, 4, 0.7))
    gum = s.ramp(s.cells(2.3), 0.045, 0.06)
    stained = s.shade(speckled, 0.55, 1.2, s.ramp(s.noise(0.7, 6, 0.65), 0.28, 0.72))
    return s.finish(s.shade(stained, 0.45, 1.0, gum), (0.3, 0.29, 0.27))


@recipe
def cobbles(s: Shader) -> Any:
    """Small paving stones of warm colours."""
    stones = s.bricks(
        ((0.3, 0.2, 0.15), (0.16, 0.13, 0.12), (0.05, 0.045, 0.04)), 0.22, 0.11, 0.007, s.position
    )
    return s.finish(
        s.shade(s.shade(stones.outputs[0], 0.6, 1.3, s.noise(22.0, 4)), 0.6, 1.2, s.noise(0.6, 5)),
        (0.2, 0.16, 0.13),
    )


@recipe
def kerbstone(s: Shader) -> Any:
    """Granite blocks."""
    blocks = s.bricks(((0.5, 0.49, 0.47), (0.34, 0.34, 0.34), (0.08, 0.08, 0.08)), 1.0, 2.0, 0.012)
    return s.finish(s.shade(blocks.outputs[0], 0.55, 1.3, s.noise(60.0, 4, 0.8)), (0.4, 0.39, 0.38))


@recipe
def iron_lid(s: Shader) -> Any:
    """A manhole cover: raised squares in cast iron."""
    squares = s.bricks(
        ((0.2, 0.19, 0.18), (0.15, 0.15, 0.15), (0.04, 0.04, 0.04)),
        0.06,
        0.06,
        0.014,
        s.position,
        0.0,
    )
    return s.finish(
        s.shade(squares.outputs[0], 0.6, 1.2, s.noise(9.0, 4)), (0.13, 0.13, 0.13), 0.3, 0.4
    )


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
    return s.finish(
        s.mix(s.cells(30.0, output="Color"), (0.05, 0.03, 0.02), (0.28, 0.18, 0.1), "MIX"),
        (0.13, 0.09, 0.06),
    )


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
    return s.finish(
        _weather(s, s.shade(wall.outputs[0], 0.6, 1.35, s.noise(14.0, 5, 0.75))), s.tint
    )


@recipe
def plaster(s: Shader) -> Any:
    """Painted render: grain, trowel marks, repairs, hairline cracks."""
    grain = s.shade(s.tint, 0.72, 1.22, s.noise(26.0, 5, 0.8))
    repaired = s.mix(
        s.ramp(s.noise(0.28, 2), 0.6, 0.64), grain, s.shade(grain, 0.78, 0.95, s.noise(5.0, 3))
    )
    crack = s.ramp(s.cells(0.35, "DISTANCE_TO_EDGE"), 0.001, 0.006)
    return s.finish(_weather(s, s.shade(repaired, 0.6, 1.0, crack)), s.tint)


@recipe
def concrete(s: Shader) -> Any:
    """Cast panels with joints, tie holes and clouds of gray."""
    panels = s.bricks(
        (s.tint, s.shade(s.tint, 0.8, 0.95, 0.5), (0.09, 0.09, 0.09)), 1.8, 1.5, 0.014, None, 0.0
    )
    clouds = s.shade(panels.outputs[0], 0.65, 1.25, s.noise(2.4, 8, 0.7))
    holes = s.ramp(s.cells(1.6, at=s.wall), 0.03, 0.045)
    return s.finish(_weather(s, s.shade(clouds, 0.35, 1.0, holes)), s.tint)


@recipe
def stone(s: Shader) -> Any:
    """Ashlar blocks of limestone or sandstone."""
    blocks = s.bricks(
        (s.tint, s.shade(s.tint, 0.66, 0.8, 0.5), (0.16, 0.14, 0.12)), 0.85, 0.38, 0.011
    )
    return s.finish(
        _weather(s, s.shade(blocks.outputs[0], 0.62, 1.28, s.noise(8.0, 7, 0.72))), s.tint
    )


@recipe
def tiles(s: Shader) -> Any:
    """Small glazed tiles."""
    pattern = s.bricks(
        (s.tint, s.shade(s.tint, 0.6, 0.85, s.noise(1.2, 2)), (0.5, 0.5, 0.48)),
        0.2,
        0.1,
        0.006,
        None,
        0.0,
    )
    return s.finish(
        _weather(s, s.shade(pattern.outputs[0], 0.75, 1.2, s.noise(6.0, 4))), s.tint, 0.35, 0.25
    )


@recipe
def cladding(s: Shader) -> Any:
    """Upright metal sheets, ribbed, scratched."""
    ribs = s.bricks(
        (s.tint, s.shade(s.tint, 0.75, 0.95, 0.5), s.shade(s.tint, 0.3, 0.4, 0.5)), 0.6, 2.6, 0.014
    )
    return s.finish(
        _weather(s, s.shade(ribs.outputs[0], 0.75, 1.2, s.noise(5.0, 7, 0.75))), s.tint, 0.25, 0.4
    )


@recipe
def trim(s: Shader) -> Any:
    """Window frames, cornices, sills: light paint or stone."""
    return s.finish(
        s.shade(s.mix(0.3, (0.72, 0.69, 0.63), s.tint), 0.6, 1.1, s.noise(9.0, 6, 0.7)),
        (0.6, 0.58, 0.53),
    )


@recipe
def dark_trim(s: Shader) -> Any:
    """Dark frames and railings."""
    return s.finish(
        s.shade((0.06, 0.062, 0.068), 0.5, 1.5, s.noise(11.0, 4)), (0.06, 0.06, 0.065), 0.35, 0.35
    )


@recipe
def roof(s: Shader) -> Any:
    """Gravel and tar felt."""
    return s.finish(
        s.shade(
            s.mix(s.cells(18.0, output="Color"), (0.13, 0.12, 0.11), (0.33, 0.31, 0.28)),
            0.6,
            1.2,
            s.noise(0.5, 5),
        ),
        (0.22, 0.21, 0.19),
    )


@recipe
def roof_tiles(s: Shader) -> Any:
    """Clay tiles on pitched roofs."""
    rows = s.bricks(((0.36, 0.13, 0.07), (0.24, 0.09, 0.06), (0.06, 0.03, 0.02)), 0.24, 0.2, 0.02)
    return s.finish(s.shade(rows.outputs[0], 0.6, 1.3, s.noise(1.4, 6, 0.7)), (0.28, 0.11, 0.07))


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
    goods = s.bricks(
        (
            s.cells(4.7, output="Color", at=s.wall),
            s.cells(9.1, output="Color", at=s.wall),
            (0.03, 0.025, 0.02),
        ),
        0.34,
        0.42,
        0.035,
    )
    lit = s.shade(goods.outputs[0], 0.12, 0.6, s.noise(2.2, 5))
    return s.finish(lit, (0.12, 0.1, 0.09), 0.45, 0.015)


# Street furniture and vehicles: these move or repeat, so their textures sit in their own frames


@recipe
def metal(s: Shader) -> Any:
    """Galvanised steel: zinc flowers and rust drips."""
    zinc = s.mix(s.cells(14.0, output="Color"), (0.27, 0.28, 0.29), (0.42, 0.43, 0.44))
    return s.finish(
        s.mix(s.ramp(s.noise(3.0, 6, 0.7), 0.58, 0.7), zinc, (0.24, 0.12, 0.06)),
        (0.34, 0.34, 0.34),
        0.3,
        0.35,
    )


@recipe
def green_paint(s: Shader) -> Any:
    """Old green enamel, on benches, bins and posts."""
    return s.finish(
        s.shade((0.03, 0.1, 0.055), 0.5, 1.6, s.noise(7.0, 6, 0.7)), (0.04, 0.1, 0.06), 0.35, 0.3
    )


@recipe
def tinted(s: Shader) -> Any:
    """Painted wood, plastic or cloth in the object's colour."""
    return s.finish(s.shade(s.tint, 0.6, 1.25, s.noise(16.0, 5, 0.7, s.object_position)), s.tint)


@recipe
def fabric(s: Shader) -> Any:
    """Cloth coloured by the face's value, as people wear it, with folds and weave."""
    ramp = s.node("ShaderNodeValToRGB", Fac=s.value)
    colors = [
        (0.02, 0.02, 0.03),
        (0.05, 0.08, 0.2),
        (0.3, 0.04, 0.04),
        (0.42, 0.38, 0.3),
        (0.08, 0.16, 0.1),
        (0.5, 0.5, 0.5),
        (0.35, 0.2, 0.08),
        (0.62, 0.5, 0.1),
        (0.1, 0.22, 0.35),
        (0.45, 0.1, 0.2),
    ]
    ramp.color_ramp.interpolation = "CONSTANT"
    for i, color in enumerate(colors):
        stop = (
            ramp.color_ramp.elements[i] if i < 2 else ramp.color_ramp.elements.new(i / len(colors))
        )
        stop.position, stop.color = i / len(colors), (*color, 1.0)
    folds = s.noise(5.0, 5, 0.7, s.stretch(s.object_position, (1.6, 1.6, 0.6)))
    return s.finish(s.shade(ramp.outputs[0], 0.45, 1.4, folds), (0.2, 0.18, 0.17))


@recipe
def skin(s: Shader) -> Any:
    """Skin of many people: the object's random number chooses."""
    return s.finish(
        s.shade(
            s.mix(s.random, (0.5, 0.3, 0.21), (0.13, 0.07, 0.045)),
            0.8,
            1.1,
            s.noise(20.0, 3, 0.6, s.object_position),
        ),
        (0.3, 0.19, 0.13),
    )


@recipe
def wood(s: Shader) -> Any:
    """Planks with grain."""
    grain = s.noise(6.0, 6, 0.7, s.stretch(s.position, (6.0, 6.0, 0.5)))
    return s.finish(s.mix(grain, (0.12, 0.065, 0.03), (0.4, 0.25, 0.13)), (0.25, 0.15, 0.08))


@recipe
def bark(s: Shader) -> Any:
    """Furrowed bark."""
    furrows = s.noise(9.0, 6, 0.75, s.stretch(s.object_position, (3.0, 3.0, 0.5)))
    return s.finish(
        s.mix(s.ramp(furrows, 0.3, 0.7), (0.045, 0.03, 0.02), (0.3, 0.24, 0.17)), (0.16, 0.12, 0.09)
    )


@recipe
def leaf(s: Shader) -> Any:
    """Leaves, each with its own green."""
    green = s.mix(s.value, (0.022, 0.06, 0.008), (0.2, 0.27, 0.045))
    return s.finish(
        s.mix(s.math("MULTIPLY", s.random, 0.35), green, (0.3, 0.24, 0.03)), (0.08, 0.12, 0.025)
    )


@recipe
def car_paint(s: Shader) -> Any:
    """Lacquer over colour, dust towards the sills."""
    _, _, z = s.split(s.object_position)
    dust = s.math(
        "ADD",
        s.ramp(z, 0.75, 0.2),
        s.math("SUBTRACT", s.noise(4.0, 5, 0.7, s.object_position), 0.75),
    )
    return s.finish(s.mix(s.ramp(dust, 0.0, 1.0), s.tint, (0.28, 0.25, 0.21)), s.tint, 0.42, 0.08)


@recipe
def car_glass(s: Shader) -> Any:
    """Dark car windows with a hint of seats."""
    return s.finish(
        s.mix(s.noise(3.5, 3, 0.5, s.object_position), (0.006, 0.007, 0.008), (0.06, 0.055, 0.05)),
        (0.03, 0.03, 0.03),
        0.5,
        0.02,
    )


@recipe
def rubber(s: Shader) -> Any:
    """Tyres, black plastic."""
    return s.finish(
        s.shade((0.022, 0.022, 0.023), 0.6, 2.2, s.noise(18.0, 4, 0.7, s.object_position)),
        (0.025, 0.025, 0.025),
    )


@recipe
def rim(s: Shader) -> Any:
    """Wheel rims and bright metal."""
    return s.finish(
        s.shade((0.42, 0.42, 0.43), 0.4, 1.2, s.noise(9.0, 4, 0.6, s.object_position)),
        (0.4, 0.4, 0.4),
        0.6,
        0.2,
    )


@recipe
def plate(s: Shader) -> Any:
    """Number plates: dark marks on white."""
    marks = s.math("GREATER_THAN", s.cells(16.0, output="Color", at=s.object_position), 0.6)
    return s.finish(s.shade((0.7, 0.7, 0.66), 0.1, 1.0, marks), (0.5, 0.5, 0.48))


@recipe
def white(s: Shader) -> Any:
    """Letters, sign borders."""
    return s.finish(s.shade((0.78, 0.77, 0.73), 0.75, 1.05, s.noise(7.0, 5)), (0.72, 0.71, 0.68))


@recipe
def poster(s: Shader) -> Any:
    """Pasted paper: blocks of colour and lines of print."""
    blocks = s.cells(2.2, output="Color", at=s.wall)
    lines = s.bricks(((0.7, 0.68, 0.6), blocks, (0.1, 0.1, 0.12)), 0.5, 0.16, 0.02)
    return s.finish(
        s.shade(s.mix(0.5, lines.outputs[0], blocks), 0.5, 1.05, s.noise(6.0, 6, 0.7)),
        (0.4, 0.38, 0.36),
    )


@recipe
def sign_red(s: Shader) -> Any:
    """Red traffic sign."""
    return s.finish(s.shade((0.5, 0.02, 0.02), 0.7, 1.15, s.noise(8.0, 4)), (0.45, 0.03, 0.03))


@recipe
def sign_blue(s: Shader) -> Any:
    """Blue traffic sign."""
    return s.finish(s.shade((0.02, 0.08, 0.42), 0.7, 1.2, s.noise(8.0, 4)), (0.03, 0.09, 0.4))


@recipe
def sign_yellow(s: Shader) -> Any:
    """Yellow traffic sign, hydrants."""
    return s.finish(s.shade((0.65, 0.42, 0.02), 0.6, 1.15, s.noise(9.0, 5)), (0.6, 0.4, 0.03))


@recipe
def lamp_red(s: Shader) -> Any:
    """A red light that is on."""
    return s.glow((1.0, 0.04, 0.02), 2.5)


@recipe
def lamp_green(s: Shader) -> Any:
    """A green light that is on."""
    return s.glow((0.05, 1.0, 0.35), 2.0)


@recipe
def lamp_off(s: Shader) -> Any:
    """A lamp glass that is off."""
    return s.finish(
        s.shade((0.6, 0.58, 0.5), 0.6, 1.1, s.noise(11.0, 3)), (0.5, 0.5, 0.45), 0.5, 0.1
    )


@recipe
def skyline(s: Shader) -> Any:
    """Far buildings: rows of windows painted on."""
    rows = s.bricks(((0.05, 0.06, 0.075), (0.16, 0.17, 0.18), s.tint), 2.6, 3.2, 0.9, None, 0.0)
    return s.finish(s.shade(rows.outputs[0], 0.7, 1.2, s.noise(0.4, 5)), s.tint)
