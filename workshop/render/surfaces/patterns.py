"""Random materials: patterns, colours, gloss, in object coordinates or metres."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import Any

import numpy as np

from workshop.render.surfaces.materials import Materials
from workshop.render.surfaces.shader import Color, Shader, Socket

_IN_ALL_DIRECTIONS = ("plain", "gradient", "grain", "clouds", "blots", "cells", "cracks")
PATTERNS = (*_IN_ALL_DIRECTIONS, "bricks", "stripes", "checks", "print")


def random_color(rng: np.random.Generator, vivid: float = 0.8) -> Color:
    """Draw a linear RGB colour, near black to near white; `vivid`: most saturation."""
    value = rng.uniform(0.03, 0.85)
    return colorsys.hsv_to_rgb(rng.random(), vivid * rng.random(), value)


def random_material(
    rng: np.random.Generator,
    kinds: Sequence[str] = PATTERNS,
    scale: float = 1.0,
    colors: Sequence[Color] | None = None,
    world: bool = False,
    gloss: float = 0.5,
) -> Any:
    """Return a Blender material with a pattern.

    Args:
        kinds: Of `PATTERNS`; one of them is drawn.
        scale: Factor on the number of lumps in a metre (or in the unit of the object).
        colours: Two linear RGB colours; default: drawn.
        world: Whether the pattern is fixed to the world and not to the object.
        gloss: Probability that the surface is glossy.
    """
    kind = str(rng.choice(list(kinds)))
    shader = Shader(kind)
    a, b = colors or (random_color(rng), random_color(rng))
    at = shader.position if world else shader.local
    frequency = scale * float(np.exp(rng.uniform(np.log(0.7), np.log(5.0))))
    color = _pattern(shader, kind, at, frequency, a, b, rng)
    if kind not in ("plain", "gradient"):
        color = shader.shade(color, 0.8, 1.15, shader.noise(9.0 * frequency, 3, 0.7, at))
    plain = tuple((np.array(a) + b) / 2)
    mirror = rng.uniform(0.15, 0.8) if rng.random() < gloss else 0.0
    return shader.finish(color, plain, mirror, float(rng.uniform(0.03, 0.5)))


def random_materials(rng: np.random.Generator, count: int, **options: Any) -> Materials:
    """Return random materials under the names "0", "1" and so on, beside those of the recipes."""
    materials = Materials()
    for k in range(count):
        materials[str(k)] = random_material(rng, **options)
    return materials


def _pattern(
    s: Shader, kind: str, at: Socket, f: float, a: Color, b: Color, rng: np.random.Generator
) -> Socket:
    """Return the colour of a pattern with about `f` lumps in a unit."""
    if kind == "plain":
        return s.shade(a, 1.0, 1.0, 0.5)
    if kind == "gradient":
        return s.mix(s.ramp(s.split(at)[rng.integers(3)], -0.9, 0.9), a, b)
    if kind == "grain":
        return s.mix(s.noise(6 * f, 6, 0.75, at), a, b)
    if kind == "clouds":
        return s.mix(s.ramp(s.noise(1.5 * f, 7, 0.6, at), 0.3, 0.7), a, b)
    if kind == "blots":
        return s.mix(s.ramp(s.noise(2 * f, 3, 0.5, at), 0.5, 0.53), a, b)
    if kind == "cells":
        return s.mix(0.45, s.cells(2.5 * f, output="Color", at=at), a)
    if kind == "cracks":
        return s.mix(s.ramp(s.cells(1.5 * f, "DISTANCE_TO_EDGE", at=at), 0.02, 0.06), a, b)
    return _ruled(s, kind, at, f, a, b)


def _ruled(s: Shader, kind: str, at: Socket, f: float, a: Color, b: Color) -> Socket:
    """Return the colour of a pattern of straight lines, on any of the three planes of the axes."""
    x, y, z = s.split(at)
    if kind == "checks":
        return s.mix(s.node("TexChecker", Vector=at, Scale=2.5 * f).outputs["Fac"], a, b)
    up = s.math("ADD", z, s.math("MULTIPLY", y, 0.5))
    plane = s.join(s.math("ADD", x, y), up)
    if kind == "bricks":
        other = s.shade(a, 0.6, 0.8, 0.5)
        return s.bricks((a, other, b), 0.6 / f, 0.25 / f, 0.03 / f, plane)
    lines, gap = (2, 0.5) if kind == "stripes" else (3, 0.45)
    ruled = s.math("GREATER_THAN", s.math("FRACT", s.math("MULTIPLY", up, lines * f)), gap)
    if kind == "stripes":
        return s.mix(ruled, a, b)
    words = s.ramp(s.noise(5 * f, 2, 0.6, s.stretch(plane, (1.0, 0.4, 1.0))), 0.46, 0.5)
    return s.mix(s.math("MULTIPLY", words, ruled), a, b)
