"""Training worlds: sets in which every frame is another scene, seen by another rig. Each frame is a
folder of its own.

SET/0001/ holds one frame in the public layout: config.yaml, cam1/0001.jpg …,
omnidepth_gt_320/00001.png.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import make_folder
from omnistereo_lib.geometry.pose import Pose
from workshop.render.camera.render_rig import RenderRig, random_rig, write_config
from workshop.render.image_sets import image_path, write_frame

# every 32nd step of the ground truth is used: within 0.05 of 192 spheres, in half the space
_KEPT = 32


@dataclass(frozen=True)
class WorldSet:
    """Frames of one kind of world.

    Attributes:
        count: Number of frames; they are numbered from 1, and all of them are rendered unless
            others are asked for.
        samples: Paths for each pixel.
        size, truth: Width and height of the images, which are gray, and of the ground-truth
            panorama: 320 × 128 is ±72°.
        quality: Of the JPEG files.
    """

    world: str
    count: int
    samples: int
    size: tuple[int, int] = (350, 336)
    truth: tuple[int, int] = (320, 128)
    quality: int = 64
    first: int = 1

    @property
    def shipped(self) -> tuple[int, ...]:
        """Numbers of all frames."""
        return tuple(range(self.first, self.first + self.count))


WORLDS = {
    "things/train": WorldSet("things", 120, samples=7),
    "rooms/train": WorldSet("room", 140, samples=9),
    "streets/train": WorldSet("street", 20, samples=7),
    # Held-out: other seeds, so other scenes and other rigs.
    "things/test": WorldSet("things", 8, samples=7, first=1001),
    "rooms/test": WorldSet("room", 8, samples=9, first=1001),
}


def is_rendered(folder: Path, number: int) -> bool:
    """Return whether a frame is there; its folder gets its name when it is complete."""
    return (folder / f"{number:04d}").is_dir()


def render_worlds(
    folder: Path, worlds: WorldSet, numbers: tuple[int, ...], seed: int
) -> Iterator[int]:
    """Render the frames that are missing, one at a time; yields the number of each finished frame.

    Args:
        folder: Where the set is, or begins to be.
        numbers: Frames wanted.
        seed: Of scenes, rigs and noise.
    """
    from workshop.render.blender import depth_panorama

    make_folder(folder)
    missing = [number for number in numbers if not is_rendered(folder, number)]
    build = _BUILDERS[worlds.world](seed) if missing else None
    for number in missing:
        rng = np.random.default_rng([seed, 40, list(_BUILDERS).index(worlds.world), number])
        T_world_rig, min_depth = build(rng, number)
        rig = random_rig(rng, min_depth)
        pictures = _photograph(rig, T_world_rig, worlds, rng, number)
        width, height = worlds.truth
        truth = 1.0 / depth_panorama(T_world_rig, worlds.truth, 180.0 * height / width)
        _write(folder, number, worlds, rig, pictures, truth)
        yield number


def _photograph(
    rig: RenderRig, T_world_rig: Pose, worlds: WorldSet, rng: np.random.Generator, number: int
) -> list[NDArray[np.uint8]]:
    """Return what the cameras see, exposed for the middle of the brightness of all of them."""
    from workshop.render.blender import fisheye_picture
    from workshop.render.camera.sensor import develop

    light = []
    for i, camera in enumerate(rig.cameras):
        pose, sampler_seed = T_world_rig @ camera.T_rig_cam, 8 * number + i
        light.append(fisheye_picture(camera.lens, pose, worlds.size, worlds.samples, sampler_seed))
    inside = np.concatenate([picture[picture.max(axis=-1) > 0] for picture in light]).mean(axis=-1)
    exposure = rng.uniform(0.14, 0.3) / max(float(np.sqrt(np.median(inside) * inside.mean())), 1e-4)
    return [
        develop(picture, camera.lens, camera.sensor, exposure, True, rng)
        * (picture.max(axis=-1) > 0)
        for picture, camera in zip(light, rig.cameras, strict=True)
    ]


def _write(
    folder: Path,
    number: int,
    worlds: WorldSet,
    rig: RenderRig,
    pictures: list[NDArray],
    truth: NDArray,
) -> None:
    """Write a frame into a folder with a temporary name, then rename the folder."""
    final, temporary = folder / f"{number:04d}", folder / f".{number:04d}"
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        paths = [image_path(temporary, number, camera) for camera in range(1, len(pictures) + 1)]
        paths.append(temporary / f"omnidepth_gt_{worlds.truth[0]}" / f"{number:05d}.png")
        for path in paths:
            path.parent.mkdir(parents=True)
        layout = {"img_fmt": "cam%d/%04d.jpg", "start": number, "step": 1, "end": number}
        write_config(temporary / "config.yaml", rig, worlds.size, layout, digits=12)
        write_frame(paths, pictures, worlds.quality, [truth], rig.min_depth, _KEPT)
        temporary.replace(final)
    except OSError as error:
        raise OmnistereoError(
            f"{final} cannot be written: {error.strerror}. Choose a writable folder"
        ) from None


# The builders prepare what all frames of a set share; what they return builds one frame:
# T_world_rig and min_depth.
Build = Callable[[np.random.Generator, int], tuple[Pose, float]]


def _each_anew(plan_scene: Callable[..., Any], build_scene: Callable[..., None]) -> Build:
    from workshop.render.blender import empty_scene

    def build(rng: np.random.Generator, number: int) -> tuple[Pose, float]:
        empty_scene()
        plan = plan_scene(rng)
        build_scene(plan, rng)
        return plan.T_world_rig, plan.min_depth

    return build


def _things(seed: int) -> Build:
    from workshop.render.things.scenes import build_things, plan_things

    return _each_anew(plan_things, build_things)


def _rooms(seed: int) -> Build:
    from workshop.render.indoor.interiors import build_room
    from workshop.render.indoor.rooms import plan_room

    return _each_anew(plan_room, build_room)


def _streets(seed: int) -> Build:
    from workshop.render.blender import empty_scene
    from workshop.render.city.district import build_city
    from workshop.render.city.drive import plan_drive
    from workshop.render.surfaces.lights import add_light, random_sky, remove_lights
    from workshop.render.things.scenes import random_pose

    empty_scene()
    district, traffic = build_city(seed)
    drive = plan_drive(district, "train", _STREET_STEPS)

    def build(rng: np.random.Generator, number: int) -> tuple[Pose, float]:
        at = drive.pose((17 * number + 5) % _STREET_STEPS).t.copy()
        at[2] += rng.uniform(-0.5, 0.6)
        largest = min(1.6, at[2] - 0.1)  # cars park 1.8 m away
        traffic.show(number, at[:2])
        remove_lights()
        add_light(random_sky(rng))
        return random_pose(rng, at), float(np.exp(rng.uniform(np.log(0.7), np.log(largest))))

    return build


_STREET_STEPS = 700
_BUILDERS = {"things": _things, "room": _rooms, "street": _streets}
