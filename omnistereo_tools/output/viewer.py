"""`index.html`, one file for any browser: look around, measure, ask why a ray has its depth."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from concurrent.futures import Future
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_text
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge import ray
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.points import Limits
from omnistereo_tools.output.webp import Fisheye, fisheye_images, webp

_PAGE = Path(__file__).with_name("page")
_SCRIPTS = ("data.js", "numbers.js", "ray.js", "gl.js", "draw.js", "page.js")
_RAY_BYTES = 2_400_000  # of all rays; with the picture the page stays below 5 MB
WIDEST = 3600  # px of the picture
_STEPS = 16382  # of inverse depth, a hundredth of a sphere; 0 is unknown


def viewer_page(
    depth: Depth, panorama: NDArray[np.uint8], limits: Limits, title: str, **options: Any
) -> str:
    """Return the page as HTML, with everything in it; arguments as `viewer_data`."""
    return page_of(viewer_data(depth, panorama, limits, title, **options))


def page_of(
    data: dict[str, Any], page: str = "page.html", scripts: Sequence[str] = _SCRIPTS
) -> str:
    """Return a page of the folder `page` in one piece, with its data and scripts."""
    page, *scripts = ((_PAGE / name).read_text(encoding="utf-8") for name in (page, *scripts))
    page = page.replace("{{SCRIPTS}}", "".join(scripts))
    return page.replace("{{DATA}}", json.dumps(data).replace("<", "\\u003c"))


def data_of(page: str) -> dict[str, Any]:
    """Return what a page of the viewer shows: `page_of` reversed."""
    return json.loads(page.partition('id="data">')[2].partition("</script>")[0])


def read_page(path: Path) -> dict[str, Any]:
    """Return `data_of` a file, with the folder and the time that it was `made` in; an
    `OmnistereoError` says if it is no page of the viewer.
    """
    text = read_text(path)
    try:
        data = data_of(text)
    except ValueError:
        data = {}
    if not {"steps", "perStep", "phi"} <= data.keys():
        raise OmnistereoError(
            f"{path} is not the page of a frame. Pass what omnistereo depth wrote"
        )
    when = datetime.fromtimestamp(path.stat().st_mtime).astimezone()
    return data | {"made": f"{path.resolve().parent.name}, {when.day} {when:%b, %H:%M}"}


def viewer_data(
    depth: Depth,
    panorama: NDArray[np.uint8],
    limits: Limits,
    title: str,
    mode: str = "look",
    trust: NDArray[Any] | None = None,
    gt_index: NDArray[Any] | None = None,
    beside: dict[str, Any] | None = None,
    images: Sequence[Future[Fisheye]] | None = None,
) -> dict[str, Any]:
    """Return what the page shows, as JSON: with the images of the depth, where each camera sees a
    ray, too.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        limits: Rays that become points.
        title: What was computed and how, one line.
        mode: How it begins: "look" around, "flat" or "points".
        trust: Of `trust.trust`, (H, W): doubtful rays are faded, and a slider leaves those that are
            right so many times of ten. None: all are trusted, and there is no slider.
        gt_index: The exact sphere indices, (H, W), if they are known: the page then shows them and
            the error, too.
        beside: What another page holds, see `data_of`: shown to the right of a divider.
        images: Of `fisheye_images`, if they are being encoded already.
    """
    rig = depth.sweep.rig
    images = fisheye_images(rig.cameras, depth.images) if images is None else images
    grid = depth.grid
    step = int(np.ceil(np.sqrt(depth.index.size * (8 if gt_index is None else 10) / _RAY_BYTES)))
    inverse_depth = depth.inverse_depth[::step, ::step]
    truth = (
        inverse_depth if gt_index is None else grid.index_to_inverse_depth(gt_index)[::step, ::step]
    )
    per_step = float(np.nanmax([inverse_depth, truth], initial=1e-6)) / _STEPS
    optional: dict[str, Any] = {}
    if trust is not None:
        optional["trust"] = packed(_percent(trust[::step, ::step]))
    if beside is not None:
        shown = ("title", "width", "height", "phi", "perStep", "steps", "trust", "made")
        optional["beside"] = {name: beside[name] for name in shown if name in beside}
    if gt_index is not None:
        optional["truth"] = packed(_in_steps(truth, per_step))
    scale = ColorScale.of(depth.inverse_depth)
    first, *_, last = grid.inverse_depths().tolist()
    per_metre = float(np.diff(grid.inverse_depth_to_index([0.0, 1.0]))[0])  # spheres per 1/m
    return optional | {
        "title": title,
        "mode": mode,
        "width": inverse_depth.shape[1],
        "height": inverse_depth.shape[0],
        "phi": np.radians(grid.phi_deg).tolist(),
        "spheres": grid.num_spheres,
        "inverse": [first, last],
        "pixelsPerDegree": max((camera.pixels_per_degree for camera in rig.cameras), default=1.0),
        "perStep": per_step,
        "percent": 100 / grid.num_spheres * per_metre,  # errors as in the paper's tables
        "steps": packed(_in_steps(inverse_depth, per_step)),
        "sigma": packed(_octaves(depth.sigma[::step, ::step], per_step)),
        "bound": packed(_octaves(depth.bound[::step, ::step], per_step)),
        "second": packed(_in_steps(depth.second[::step, ::step], per_step)),
        "confidence": packed(_percent(depth.confidence[::step, ::step])),
        "doubtful": 100 * DOUBTFUL,
        "low": scale.low,
        "high": scale.high,
        "ticks": scale.ticks(),
        "colors": _base64(scale.bar(256)),
        "maxDepth": min(limits.max_depth, 1e9),
        "minConfidence": limits.min_confidence,
        "picture": webp(_narrow(panorama), 85),
        "cameras": [
            _camera(*image.result(), pose)
            for image, pose in zip(images, rig.T_rig_cam, strict=False)
        ],
        "ray": ray.for_the_page(),
    }


def _in_steps(inverse_depth: NDArray[Any], per_step: float) -> NDArray[np.uint16]:
    """Return inverse depths as steps from 1; 0 is unknown, what is nearer is the last."""
    steps = np.where(np.isfinite(inverse_depth), 1 + np.nan_to_num(inverse_depth) / per_step, 0)
    return steps.round().clip(0, _STEPS + 1).astype("<u2")


def _octaves(widths: NDArray[Any], per_step: float) -> NDArray[np.uint8]:
    """Return widths in 1/m as sixteenths of octaves from a step on, from 1; 0 is unknown."""
    known = np.where(widths > 0, widths, per_step)
    sixteenths = 1 + 16 * np.log2(known / per_step)
    return np.where(np.isnan(widths), 0, sixteenths.round().clip(1, 255)).astype(np.uint8)


def _percent(values: NDArray[Any]) -> NDArray[np.uint8]:
    return (100 * np.nan_to_num(values)).round().astype(np.uint8)


def _camera(camera: OcamCamera, image: str, T_rig_cam: Pose) -> dict[str, Any]:
    """Return what projects points into a camera, and its image."""
    T_cam_rig = T_rig_cam.inverse()
    return {
        "R": T_cam_rig.R.tolist(),
        "t": T_cam_rig.t.tolist(),
        "place": T_rig_cam.t.tolist(),
        "poly": list(camera.inv_poly),
        "affine": list(camera.affine),
        "center": list(camera.center),
        "maxAngle": np.radians(camera.max_fov_deg / 2) - np.pi / 2,
        "image": image,
    }


def packed(values: NDArray[Any]) -> str:
    """Return unsigned integers (H, W) as text: differences in rows, low bytes first, deflated."""
    differences = np.diff(values, axis=1, prepend=values.dtype.type(0))  # they wrap around
    planes = np.ascontiguousarray(differences).view(np.uint8).reshape(values.size, -1).T
    return _base64(zlib.compress(planes.tobytes(), 6))


def _base64(values: NDArray[Any] | bytes) -> str:
    return base64.b64encode(
        values if isinstance(values, bytes) else np.ascontiguousarray(values).tobytes()
    ).decode()


def _narrow(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    if width <= WIDEST:
        return picture
    small = cv2.resize(
        picture, (WIDEST, round(height * WIDEST / width)), interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.uint8)
