"""The renderer with noise that follows the pose for Blender; frames of 25 × 24 pixels."""

import sys
from dataclasses import replace
from importlib.machinery import ModuleSpec
from types import ModuleType, SimpleNamespace

import numpy as np

from workshop.render import image_sets as frames
from workshop.render.city.layout import plan_district
from workshop.render.image_sets import SETS

TINY = replace(SETS["sunny/test"], size=(25, 24), samples=1, truths=((16, 4), (24, 6)))


def replace_blender(setitem, setattr):
    """Replace all that needs Blender; the arguments do what their names say."""
    bpy = ModuleType("bpy")
    bpy.__spec__ = ModuleSpec("bpy", None)
    blender = SimpleNamespace(empty_scene=lambda: None)
    city = SimpleNamespace(
        build_city=lambda seed: (plan_district(seed), SimpleNamespace(show=lambda *_: None))
    )
    lights = SimpleNamespace(add_light=lambda name: SimpleNamespace(exposure=1.0))
    for name, module in {
        "bpy": bpy,
        "workshop.render.blender": blender,
        "workshop.render.city.district": city,
        "workshop.render.surfaces.lights": lights,
    }.items():
        setitem(sys.modules, name, module)

    def render_frame(images, rig, T_world_rig, exposure, seed):
        rng = np.random.default_rng(np.abs(T_world_rig.t * 1e6).astype(int))
        pictures = [rng.integers(0, 255, (*images.size[::-1], 3), np.uint8) for _ in rig.cameras]
        return pictures, [rng.random(size[::-1]) for size in images.truths]

    setattr(frames, "_render_frame", render_frame)
    setitem(SETS, "sunny/test", TINY)


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
