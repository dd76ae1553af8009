"""A world whose depth is known in closed form: a textured box around a rig of ideal fisheye
cameras.

It is the oracle of the tests: nothing here is shared with the library but the cameras and the
poses."""

import cv2
import numpy as np
import pytest

import omnistereo_lib as osl
from omnistereo_lib.frame import write_inverse_depth
from omnistereo_lib.pictures import write_image
from omnistereo_lib.stereo.sweep import SphereSweep

HALF_SIZE = np.array([2.6, 1.4, 3.1])  # metres from the box's centre to its walls
CENTER = np.array([0.3, -0.2, 0.4])


def camera(width=400, height=384, max_fov_deg=220.0, shift=(0.0, 0.0)):
    """An equidistant lens, r = f·θ, whose circle fits the image; its polynomials are a fit."""
    f = (min(width, height) / 2 - 2) / np.radians(max_fov_deg / 2)
    theta = np.linspace(1e-4, np.radians(max_fov_deg / 2 + 1), 4000)
    radius = f * theta
    powers = np.array([0, *range(2, 13)])
    scale = radius[-1]
    coefficients = np.linalg.lstsq(
        (radius[:, None] / scale) ** powers, -radius / np.tan(theta), rcond=None
    )[0]
    poly = np.zeros(13)
    poly[powers] = coefficients / scale**powers
    center = ((width - 1) / 2 + shift[0], (height - 1) / 2 + shift[1])
    return osl.OcamCamera(
        poly, [f * np.pi / 2, f], center, (1.0, 0.0, 0.0), (width, height), max_fov_deg
    )


def polar_rays(theta, azimuth):
    """Unit rays (..., 3) at angle θ from the axis; azimuth 0 is +x (right), π/2 is +y (down)."""
    sine, cosine = np.sin(theta), np.cos(theta)
    rays = np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    return np.stack(rays, -1)


def rig(half_baseline=0.3, cameras=4, **lens):
    """Cameras on a circle, looking outwards, each a little turned and off its place."""
    rng = np.random.default_rng(5)
    poses = []
    for k in range(cameras):
        angle = 2 * np.pi * k / cameras
        place = half_baseline * np.array([np.sin(angle), 0.0, np.cos(angle)])
        outwards = osl.Pose.from_vector([0, angle, 0, *place])
        poses.append(outwards @ osl.Pose.from_vector(rng.normal(0, 0.01, 6)))
    return osl.Rig([camera(shift=(k, -k), **lens) for k in range(cameras)], poses)


def distance(origin, rays):
    """Distance from points inside the box to its wall along unit rays; shapes (3,) and (..., 3)."""
    with np.errstate(divide="ignore"):
        to_wall = (np.sign(rays) * HALF_SIZE - (origin - CENTER)) / rays
    return np.where(rays == 0, np.inf, to_wall).min(-1)


def texture(points, finest=0.06):
    """A gray value in 0 to 255 with detail from a metre down to `finest`; (..., 3) → (...)."""
    rng = np.random.default_rng(1)
    value = np.zeros(points.shape[:-1])
    for wavelength in (w for w in (1.0, 0.5, 0.25, 0.12, 0.06) if w >= finest):
        for _ in range(4):
            direction = rng.normal(size=3)
            direction *= 2 * np.pi / wavelength / np.linalg.norm(direction)
            value += np.sin(points @ direction + rng.uniform(0, 2 * np.pi)) * wavelength**0.3
    return 127.5 + 127.5 * np.tanh(value / 5)


def images(rig, finest=0.06):
    """What the cameras of a rig see, float32; the rim is continued, so there is no edge."""
    pictures = []
    for lens, pose in zip(rig.cameras, rig.T_rig_cam, strict=True):
        width, height = lens.image_size
        rays, _ = lens.unproject(np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1))
        rays = rays @ pose.R.T
        points = pose.t + rays * distance(pose.t, rays)[..., None]
        pictures.append(texture(points, finest).astype(np.float32))
    return pictures


def true_index(rig, grid):
    """The sphere index of the wall on every ray, from the mean of the camera centres."""
    center = np.mean([pose.t for pose in rig.T_rig_cam], 0)
    return grid.depth_to_index(distance(center, grid.rays()))


def true_depth(rig, grid, pictures=()):
    """The exact depth of the box, with full confidence."""
    index = true_index(rig, grid).astype(np.float32)
    return osl.Depth(index, np.ones_like(index), SphereSweep(rig, grid), pictures)


def beyond_walls(points, rig):
    """How far points (..., 3) around a rig's centre are from the box's middle: 1 on its walls."""
    return (np.abs(points + rig.centers.mean(0) - CENTER) / HALF_SIZE).max(-1)


def write_drive(folder, frames, step=0.05):
    """A rig that moves along x through the box: `rig.yaml`, `view1` … with numbered pictures."""
    still = rig(width=100, height=96)
    osl.save_rig(osl.Rig(still.cameras, still.T_rig_cam, min_depth=0.6), folder / "rig.yaml")
    for n in range(1, frames + 1):
        moved = still.transformed(osl.Pose.from_vector([0, 0, 0, step * n, 0, 0]))
        for k, picture in enumerate(images(moved, finest=0.25), 1):
            (folder / f"view{k}").mkdir(exist_ok=True)
            write_image(folder / f"view{k}" / f"cam{k}_{n:03}.png", picture)
    return folder


def write_set(folder, still, grid, places, first=1):
    """A data set of the public layout: a frame at each place (metres), with ground truth."""
    (folder / f"omnidepth_gt_{grid.width}").mkdir(parents=True)
    osl.save_rig(
        osl.Rig(still.cameras, still.T_rig_cam, min_depth=grid.min_depth), folder / "config.yaml"
    )
    for number, place in enumerate(places, first):
        step = osl.Pose.from_vector([0, 0, 0, *place])
        moved = osl.Rig(still.cameras, [step @ pose for pose in still.T_rig_cam])
        for k, picture in enumerate(images(moved, finest=0.25), 1):
            (folder / f"cam{k}").mkdir(exist_ok=True)
            write_image(folder / f"cam{k}" / f"{number:04}.png", picture)
        truth = grid.index_to_inverse_depth(true_index(moved, grid))
        write_inverse_depth(folder / f"omnidepth_gt_{grid.width}" / f"{number:05}.tiff", truth)
    return folder


def refused(said):
    """Expect the library's error, in words that a regular expression finds."""
    return pytest.raises(osl.OmnistereoError, match=said)


def write_video(path, pictures, rate=20, codec="FFV1"):
    """Write gray or BGR pictures as a video, by default a lossless one."""
    size = pictures[0].shape[1::-1]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate, size)
    for picture in pictures:
        colors = picture if picture.ndim == 3 else np.stack([picture] * 3, -1)
        video.write(colors.astype(np.uint8))
    video.release()
