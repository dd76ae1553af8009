"""The student's picture beside the right one: what a mistake does to a street.

The inputs below are for `Open(..., real=...)`: panoramas of the sample frame, 320 × 80, so that a
check stays quick.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import omnistereo_lib as osl
from omnistereo_lib.frame import Frame

_SPHERE = 20  # of 64: the white car is in focus
# rows down and columns to the right, of the paths of SGM
EIGHT = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]


def show(function: Callable[..., Any], answer: Callable[..., Any], inputs: tuple) -> None:
    """Show what a function and the right one make of the same inputs, on one colour scale; NaN is
    grey.

    Nothing is shown of a function that stops, whose picture has another shape, or that looks right
    here. Of a cost volume the winners are shown.
    """
    import matplotlib.pyplot as plt

    from course.figures.plot import show_picture

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yours = np.asarray(function(*copy.deepcopy(inputs)), np.float64)
        except (Exception, SystemExit):  # the sentence above has said it
            return
        right = np.asarray(answer(*inputs), np.float64)
    if (
        yours.shape != right.shape
        or np.allclose(yours, right, rtol=1e-2, equal_nan=True)
        or right.ndim < 1
    ):
        return
    if right.ndim == 1:
        _show_curves(yours, right, answer.__name__)
        return
    if right.ndim == 3 and right.shape[-1] > 3:
        yours, right = (volume.argmin(axis=-1).astype(float) for volume in (yours, right))
    low, high = np.nanmin(right), np.nanmax(right)
    fig, axes = plt.subplots(2, figsize=(8, 4.6), layout="constrained")
    for ax, image, title in zip(axes, (yours, right), ("yours", "right"), strict=True):
        known = np.isfinite(image)
        ax.set_facecolor("0.73")
        if image.ndim == 3:
            image = np.where(known, image, 185).clip(0, 255).astype(np.uint8)
        ax.imshow(image, cmap="gray", vmin=low, vmax=high, interpolation="nearest")
        ax.set_title(title, loc="left", fontsize=10)
        ax.set_xticks([])
        ax.set_yticks([])
    name = answer.__name__
    show_picture(
        fig,
        f"Two panoramas of a street: what your {name} makes of it, and below it what the"
        " right one makes",
    )


def _show_curves(yours: NDArray[np.float64], right: NDArray[np.float64], name: str) -> None:
    """Show two curves, one dashed over the other."""
    import matplotlib.pyplot as plt

    from course.figures.plot import show_picture

    fig, ax = plt.subplots(figsize=(8, 2.6), layout="constrained")
    ax.plot(right, color="k", lw=2, label="right")
    ax.plot(yours, "--", color="C3", label="yours")
    known = right[np.isfinite(right)]
    margin = max(np.ptp(known), 1e-9)
    ax.set(ylim=(known.min() - margin, known.max() + margin), xlabel="number of the value, from 0")
    ax.legend(loc="upper left", bbox_to_anchor=(1, 1))
    show_picture(fig, f"Two curves: the values of your {name}, dashed, and the right ones")


@cache
def _street() -> tuple[Frame, osl.SphereSweep]:
    folder = Path(__file__).resolve().parents[2] / "data_samples" / "sunny"
    data = osl.load_dataset(folder, split="test")
    grid = osl.SphereGrid(320, 80, phi_deg=(-45, 45), num_spheres=64, min_depth=data.rig.min_depth)
    return data.frame(831), osl.SphereSweep(data.rig, grid)


def warped() -> NDArray[np.float64]:
    """Return the four images on one sphere, in colours, (4, H, W, 3), NaN where unseen."""
    frame, sweep = _street()
    return np.stack(sweep.warp(frame.images, _SPHERE)).astype(np.float64)


def gray() -> NDArray[np.float64]:
    """Return the same in grey, (4, H, W)."""
    return warped().mean(axis=-1)


def image() -> NDArray[np.float64]:
    """Return the image of the first camera in grey."""
    return np.mean(_street()[0].images[0], axis=-1)


def between() -> tuple:
    """Return an image and its pixels at the rays of one sphere, (H, W, 2), NaN if unseen."""
    uv, visible = _street()[1].project_sphere(0, _SPHERE)
    return image(), np.where(visible[..., None], uv, np.nan)


def view() -> tuple:
    """Return the first camera: image, camera, pose, and points of one sphere (H, W, 3)."""
    _, sweep = _street()
    points = sweep.grid.rays() * float(sweep.grid.index_to_depth(_SPHERE))
    return image(), sweep.rig.cameras[0], sweep.rig.T_rig_cam[0], points


def costs() -> tuple:
    """Return the path costs of every fourth ray of the street, (20, 80, 16)."""
    sum_of_paths = import_module("course.exercises.nb05").sum_of_paths

    return (sum_of_paths(*volume(), EIGHT),)


def confidences() -> tuple:
    """Return errors of the winners of these costs, their confidences (20, 80), and fractions."""
    path_costs = costs()[0]
    frame, sweep = _street()
    wrong = np.abs(path_costs.argmin(axis=-1) - frame.gt_index(sweep.grid)[::4, ::4] / 63 * 15)
    two = np.sort(path_costs, axis=-1)
    return wrong, 1 - two[..., 0] / two[..., 1], np.linspace(0, 0.9, 46)


def truth() -> tuple:
    """Return the exact sphere indices of the street (H, W), and the number of spheres."""
    frame, sweep = _street()
    return frame.gt_index(sweep.grid), sweep.grid.num_spheres


def volume() -> tuple:
    """Return ZNCC's costs of every fourth ray, (20, 80, 16), float64, and two penalties."""
    frame, sweep = _street()
    grid = osl.SphereGrid(80, 20, (-45, 45), num_spheres=16, min_depth=sweep.grid.min_depth)
    costs = osl.cost_volume(osl.SphereSweep(sweep.rig, grid), frame.images).numpy()
    return np.nan_to_num(costs, nan=0.5).astype(np.float64), 0.1, 1.0


def sight() -> tuple:
    """Return of camera 1's line of sight: centre, points, 1/m, elevations, fractions."""
    frame, sweep = _street()
    inverse_depth = sweep.grid.index_to_inverse_depth(frame.gt_index(sweep.grid))
    points = sweep.grid.rays() / np.maximum(inverse_depth, 0.01)[..., None]
    return (
        sweep.rig.centers[0],
        points,
        inverse_depth,
        sweep.grid.phi_deg,
        1 / np.geomspace(1.05, 60, 40),
    )
