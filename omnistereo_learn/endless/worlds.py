"""Endless worlds: training frames that no data set holds, each a new scene seen by a new rig.

Frame number n of a seed is the same on every machine and in every run, so a training that draws a
new one at every step still resumes to the same weights. What a network has to cope with is drawn
more widely than in any data set: baselines, nearest depths, two to six cameras, lenses, poses,
light, and what a lens and a sensor do to an image.
"""

import math
import os
import signal
import weakref
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from omnistereo_learn.endless.caster import BOX, Tree, build_tree, inverse_distances, look
from omnistereo_learn.endless.objects import log_uniform
from omnistereo_learn.endless.scenes import SCENES
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose, rotation_from_axis_angle
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import Sampling, SphereGrid
from omnistereo_lib.lazy import lazy_property
from omnistereo_rigs.formats.camera_models import make_camera_model
from omnistereo_rigs.formats.fit import fit_ocam

_AHEAD = 6  # frames for each worker to draw while training steps run
# frames, of which some come again: two steps share one, and a validation comes back to those before
# it
_KEPT = 64
# so that no other generator of a seed draws the same numbers: of the frames, of their faults
_PURPOSE, _FAULTS = 11, 12


@dataclass(frozen=True, eq=False)
class Scene:
    """Primitives and light, as the ray caster takes them, in metres."""

    primitives: NDArray[Any]  # of dtype PRIMITIVE
    light: NDArray[Any]  # one record of dtype LIGHT

    @lazy_property
    def _tree(self) -> Tree:
        return build_tree(self.primitives)

    def inverse_depth_along(
        self, rays: NDArray[Any], origin: NDArray[Any] | None = None
    ) -> NDArray[np.float32]:
        """Return the inverse distance, 1/m, along unit rays (..., 3) from a point; 0 is sky."""
        flat = np.ascontiguousarray(rays, np.float64).reshape(-1, 3)
        inverse = np.empty(len(flat), np.float32)
        inverse_distances(
            self.primitives, self._tree, np.zeros(3) if origin is None else origin, flat, inverse
        )
        return inverse.reshape(np.shape(rays)[:-1])

    def image(self, camera: OcamCamera, pose: Pose) -> NDArray[np.float32]:
        """Return the radiance that a camera sees, (height, width); 1 is white, NaN outside.

        `pose` takes camera coordinates to those of the scene.
        """
        (rays, visible), pixel = _pixel_rays(camera), np.radians(1 / camera.pixels_per_degree)
        gray = np.full(visible.shape, np.nan, np.float32)
        look(self.primitives, self._tree, self.light, pose.t, rays @ pose.R.T, visible, pixel, gray)
        return gray


def _pixel_rays(camera: OcamCamera) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return unit rays (h, w, 3) of the pixels of a camera, 0 where unseen, and which are seen."""
    visible = camera.visible_pixels()
    rays = np.zeros((*visible.shape, 3))
    rays[visible], _ = camera.unproject(np.argwhere(visible)[:, ::-1])
    return rays, visible


@dataclass(frozen=True, eq=False)
class EndlessFrame:
    """A frame as `Frame`, whose ground truth is computed instead of read."""

    number: int
    rig: Rig
    images: list[NDArray[np.uint8]]
    scene: Scene
    gt_path: ClassVar[None] = None  # nothing is stored

    def inverse_depth_along(
        self, rays: NDArray[Any], sampling: Sampling = "center"
    ) -> NDArray[np.float32]:
        """Return the exact inverse depth, 1/m, along unit rays (..., 3); 0 is sky."""
        return self.scene.inverse_depth_along(rays)

    def gt_index(self, grid: SphereGrid) -> NDArray[np.float64]:
        """Return the ground-truth sphere index n̂ on a grid, shape (H, W), not rounded."""
        return grid.inverse_depth_to_index(self.scene.inverse_depth_along(grid.rays()))


class EndlessWorlds:
    """The frames of a seed by number; the next ones are drawn ahead by other processes.

    Args:
        workers: Number of processes; default: the processors but one. 0: drawn when asked for.
        faults: Of rigs and light; see `draw_frame`.
    """

    def __init__(self, seed: int, workers: int | None = None, faults: bool = False) -> None:
        self.seed, self.faults = seed, faults
        self._workers = max(1, (os.cpu_count() or 2) - 1) if workers is None else workers
        self._drawn: dict[int, Any] = {}  # frames, or futures of frames

    def __getstate__(self) -> dict[str, Any]:
        """Return the seed and the number of processes: another process draws its frames itself."""
        kept = {"seed": self.seed, "faults": self.faults, "_workers": self._workers}
        return kept | {"_drawn": {}}

    def frame(self, number: int) -> EndlessFrame:
        """Return a frame; the ones that follow are drawn meanwhile."""
        ahead = _AHEAD * self._workers
        for n in range(number, number + 1 + ahead):
            if n not in self._drawn:
                draw = partial(draw_frame, self.seed, n, faults=self.faults)
                self._drawn[n] = self._pool.submit(draw) if self._workers else draw()
        drawn = self._drawn[number]
        for n in list(self._drawn)[: -_KEPT - ahead]:
            del self._drawn[n]
        return drawn.result() if self._workers else drawn

    @lazy_property
    def _pool(self) -> ProcessPoolExecutor:
        # Not forked: the copy of a process whose threads hold locks may wait for them forever.
        pool = ProcessPoolExecutor(self._workers, get_context("spawn"), _prepare_worker)
        weakref.finalize(self, pool.shutdown, wait=False, cancel_futures=True)
        return pool


def _prepare_worker() -> None:
    """Take one core, leave Ctrl-C to the parent, and end with it even where it is killed."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with(parent: Any) -> None:
        parent.join()
        os._exit(1)

    Thread(target=end_with, args=[parent_process()], daemon=True).start()


def draw_frame(seed: int, number: int, size: float = 1.0, faults: bool = False) -> EndlessFrame:
    """Draw a frame; images are about 300 to 400 pixels wide, times `size`.

    With `faults` the same rig may turn while its shutters are open, sun or lamp dazzle its cameras,
    and its file is a little off: `turned`, `with_glare`, `misstated`.
    """
    rng = np.random.default_rng([seed, _PURPOSE, number])
    builder, light, radius = SCENES[rng.integers(len(SCENES))](rng)
    rig = draw_rig(rng, radius, size)
    scene = Scene(
        without_obstacles(np.concatenate(builder.primitives), rig, 0.05 + 0.1 * radius), light
    )
    nearest = 1 / max(scene.inverse_depth_along(SphereGrid(160, 40).rays()).max(), 0.01)
    rig = Rig(rig.cameras, rig.T_rig_cam, float(nearest * rng.uniform(0.2, 0.7)))
    radiance = [
        scene.image(lens, pose) for lens, pose in zip(rig.cameras, rig.T_rig_cam, strict=True)
    ]
    stated = rig
    if faults:
        chance = np.random.default_rng([seed, _FAULTS, number])
        turn = chance.choice([0, 1]) * chance.normal(0, np.radians(0.7), 3)
        veil = chance.choice([0, log_uniform(chance, 0.05, 1)])
        radiance = [
            with_glare(turned(gray, camera, pose.R.T @ turn), camera, pose, scene, veil)
            for gray, camera, pose in zip(radiance, rig.cameras, rig.T_rig_cam, strict=True)
        ]
        stated = misstated(rig, chance)
    return EndlessFrame(number, stated, develop(radiance, rig.cameras, rng), scene)


def turned(
    gray: NDArray[np.float32], camera: OcamCamera, turn: NDArray[Any]
) -> NDArray[np.float32]:
    """Return the mean radiance while a camera turns by an axis-angle vector of its own frame."""
    rays, visible = _pixel_rays(camera)
    still, moments = np.where(visible, gray, 0), []
    # As many moments as pixels that it turns by, and one. What turns into view looks as the rim.
    count = 1 + math.ceil(float(np.linalg.norm(np.degrees(turn))) * camera.pixels_per_degree)
    for share in (np.arange(count) + 0.5) / count - 0.5:
        uv, inside = camera.project(rays @ rotation_from_axis_angle(share * turn).T)
        x, y = uv.astype(np.float32).transpose(2, 0, 1)
        moved = cv2.remap(still, x, y, cv2.INTER_LINEAR)
        moments.append(np.where(inside, moved, gray))
    return np.mean(moments, 0)


def with_glare(
    gray: NDArray[np.float32], camera: OcamCamera, pose: Pose, scene: Scene, strength: float
) -> NDArray[np.float32]:
    """Return radiance with a veil around the lamp or the sun, if nothing stands before it."""
    light = scene.light
    to_light = light["lamp_at"] - pose.t if light["lamp"] > 0 else 1e6 * light["to_sun"]
    distance = float(np.linalg.norm(to_light))
    free = scene.inverse_depth_along(to_light / distance, pose.t) < 0.95 / distance
    (u, v), inside = camera.project(to_light @ pose.R)
    if not (free and inside and light["lamp"] + light["sun"] > 0):
        return gray
    y, x = np.ogrid[: gray.shape[0], : gray.shape[1]]
    away2 = ((x - u) ** 2 + (y - v) ** 2) / (0.15 * camera.max_radius) ** 2
    return gray + np.float32(strength * np.nanmax(gray)) / (1 + away2).astype(np.float32)


def misstated(rig: Rig, rng: Generator, degrees: float = 0.05, pixels: float = 0.3) -> Rig:
    """Return a rig as a good calibration has it: orientations and centres of images off a bit."""
    off = [Pose.from_vector([*rng.normal(0, np.radians(degrees), 3), 0, 0, 0]) for _ in rig.cameras]
    cameras = [replace(c, center=tuple(c.center + rng.normal(0, pixels, 2))) for c in rig.cameras]
    poses = [pose @ error for pose, error in zip(rig.T_rig_cam, off, strict=True)]
    return Rig(cameras, poses, rig.min_depth)


def without_obstacles(primitives: NDArray[Any], rig: Rig, clearance: float) -> NDArray[Any]:
    """Leave out what a camera would stand in or touch, but not what is all around it."""
    keep = np.ones(len(primitives), bool)
    for place in [*rig.centers, np.zeros(3)]:
        local = np.abs(
            np.einsum("nij,nj->ni", primitives["rotation"], place - primitives["center"])
        )
        outside = np.linalg.norm(np.maximum(local - primitives["half"], 0), axis=1)
        round_ = primitives["shape"] != BOX
        depth = np.where(
            round_, 1 - np.linalg.norm(local / primitives["half"], axis=1), 1
        ) * np.min(np.maximum(primitives["half"] - local, 0), axis=1)
        keep &= (outside > clearance) | (depth > 3 * clearance)
    return primitives[keep]


def draw_rig(rng: Generator, radius: float, size: float = 1.0) -> Rig:
    """Draw a rig of 2 to 6 cameras about a radius in metres around the origin."""
    count = int(rng.choice([2, 3, 4, 5, 6], p=[0.1, 0.2, 0.45, 0.12, 0.13]))
    stacked = count == 2 and rng.random() < 0.5  # one above the other, both looking up or down
    heights = (
        rng.uniform(0.3, 1.0) * radius * (-1) ** np.arange(count)
        if rng.random() < 0.15
        else np.zeros(count)
    )
    widest = rng.uniform(195, 230) if count < 4 else rng.uniform(160, 230)
    width, bend, alike = int(size * rng.integers(300, 401)), rng.uniform(-1, 1), rng.random() < 0.7
    whole = Pose.from_vector([*rng.normal(0, np.radians(4), 3), 0, 0, 0])
    start = rng.uniform(0, 2 * np.pi)
    looks = rng.choice([-1, 1])
    sloppy = np.radians(rng.choice([1, 4]))
    upright = rng.random() < 0.85
    cameras, poses = [], []
    for k in range(count):
        azimuth = start + 2 * np.pi * k / count + rng.normal(0, 0.08)
        outwards = np.array([math.sin(azimuth), 0, math.cos(azimuth)])
        t = radius * rng.uniform(0.85, 1.15) * outwards
        t[1] += heights[k] + radius * rng.normal(0, 0.12)
        facing = Pose.from_vector([0, azimuth, 0, *t])
        if stacked:
            off = radius * rng.normal(0, 0.05, 3) + [0, radius * (-1) ** k, 0]
            facing = Pose.from_vector([looks * np.pi / 2, 0, 0, *off])
        roll = 0.0 if upright else rng.choice([np.pi / 2, np.pi, rng.uniform(0, 2 * np.pi)])
        own = Pose.from_vector([*rng.normal(0, sloppy, 3), 0, 0, 0]) @ Pose.from_vector(
            [0, 0, roll, 0, 0, 0]
        )
        poses.append(whole @ facing @ own)
        fov = widest if alike else rng.uniform(max(160, widest - 25), widest)
        cameras.append(_draw_camera(rng, width, fov, bend if alike else rng.uniform(-1, 1)))
    return Rig(cameras, poses).recentered()


def _draw_camera(rng: Generator, width: int, fov_deg: float, bend: float) -> OcamCamera:
    """Draw a lens between stereographic (bend 1), equidistant (0) and equisolid (-1)."""
    k1, k2 = (bend / 12, bend / 120) if bend > 0 else (bend / 24, -bend / 1920)
    half = math.radians(fov_deg / 2)
    height = int(width * rng.uniform(0.92, 1.0))
    focal = 0.5 * width * rng.uniform(0.94, 1.06) / (half * (1 + k1 * half**2 + k2 * half**4))
    cx, cy = width / 2 - 0.5 + rng.normal(0, 2), height / 2 - 0.5 + rng.normal(0, 2)
    stretched = focal * rng.uniform(0.995, 1.005)
    lens = make_camera_model(
        "kb4", {"fx": focal, "fy": stretched, "cx": cx, "cy": cy, "k1": k1, "k2": k2}
    )
    return fit_ocam(lens, (width, height), fov_deg)[0]


def develop(
    radiance: list[NDArray[Any]], cameras: Sequence[OcamCamera], rng: Generator
) -> list[NDArray[np.uint8]]:
    """Return what lens and sensor make of radiance: vignetting, dirt, blur, noise, JPEG."""
    bright = np.nanpercentile(np.concatenate([gray.ravel() for gray in radiance]), 90)
    exposure = rng.uniform(0.3, 1.1) / max(float(bright), 1e-3)
    gamma, falloff = rng.uniform(0.4, 0.8), rng.choice([0, rng.uniform(0.1, 0.7)])
    differ, noise = rng.choice([0.03, 0.25]), rng.choice([0.002, rng.uniform(0.002, 0.03)])
    blur, quality = rng.choice([0, rng.uniform(0.3, 0.9)]), int(rng.integers(55, 98))
    images = []
    for gray, camera in zip(radiance, cameras, strict=True):
        (height, width), visible = gray.shape, np.isfinite(gray)
        y, x = np.ogrid[:height, :width]
        distance2 = (
            (x - camera.center[0]) ** 2 + (y - camera.center[1]) ** 2
        ) / camera.max_radius**2
        light = np.where(visible, gray, 0) * (
            exposure * math.exp(rng.normal(0, differ)) * (1 - falloff * np.minimum(distance2, 1))
        )
        if rng.random() < 0.15:
            light = _with_dirt(light, rng)
        if blur:
            light = cv2.GaussianBlur(light, (0, 0), blur)
        light += (
            np.float32(noise)
            * np.sqrt(0.1 + np.clip(light, 0, 1))
            * rng.standard_normal(gray.shape, np.float32)
        )
        tone = np.clip(light, 0, 1) ** gamma * 255 * visible
        _, encoded = cv2.imencode(
            ".jpg", tone.round().astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )
        images.append(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_GRAYSCALE), np.uint8))
    return images


def _with_dirt(light: NDArray[Any], rng: Generator) -> NDArray[Any]:
    """Return an image through drops and dust on the lens: out of focus, they veil it."""
    height, width = light.shape
    veil = np.zeros_like(light)
    for _ in range(rng.integers(1, 8)):
        centre = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        radius = int(log_uniform(rng, 0.01, 0.06) * width) + 1
        cv2.circle(veil, centre, radius, rng.uniform(0.2, 0.9), -1)
    veil = cv2.GaussianBlur(veil, (0, 0), 0.01 * width)
    behind = cv2.GaussianBlur(light, (0, 0), 0.02 * width)
    return light * (1 - veil) + veil * (0.6 * behind + rng.uniform(0, 0.3))
