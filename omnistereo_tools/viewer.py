"""`index.html`: one file, read offline in any browser, to look around in the panorama and to rotate the points."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.pictures import ColorScale
from omnistereo_tools.points import Limits
from omnistereo_tools.trust import DOUBTFUL

_PAGE = Path(__file__).with_name("viewer.html")
_RAY_BYTES = 2_400_000  # of all rays; with the picture the page stays below 5 MB
_WIDEST = 2400  # px of the picture
_STEPS = 65534  # of inverse depth in 16 bits; 0 is unknown


def viewer_page(depth: Depth, panorama: NDArray[np.uint8], limits: Limits, title: str, **options: Any) -> str:
    """Return the page as HTML, with everything in it; arguments as `viewer_data`."""
    return page_of(viewer_data(depth, panorama, limits, title, **options))


def page_of(data: dict[str, Any]) -> str:
    """Return the page that shows what `viewer_data` returned."""
    return _PAGE.read_text(encoding="utf-8").replace("{{DATA}}", json.dumps(data).replace("<", "\\u003c"))


def viewer_data(
    depth: Depth,
    panorama: NDArray[np.uint8],
    limits: Limits,
    title: str,
    mode: str = "look",
    trust: NDArray | None = None,
    gt_index: NDArray | None = None,
) -> dict[str, Any]:
    """Return what the page shows, as JSON.

    Args:
        panorama: uint8 array, any size, RGB: the whole panorama, sharper than the depth
        limits: Rays that become points.
        title: What was computed and how, one line.
        mode: How it begins: "look" around, "flat" or "points".
        trust: Of `trust.trust`, (H, W): doubtful rays are faded, and a slider hides them. None: all are trusted.
        gt_index: The exact sphere indices, (H, W), if they are known: the page then shows them and the error, too.
    """
    grid = depth.grid
    step = int(np.ceil(np.sqrt(depth.index.size * (4 if gt_index is None else 6) / _RAY_BYTES)))
    inverse_depth = depth.inverse_depth[::step, ::step]
    per_step = max(float(np.nanmax(inverse_depth, initial=1e-6)), 1e-6) / _STEPS
    scale = ColorScale.of(depth.inverse_depth)
    optional: dict[str, Any] = {}
    if trust is not None:
        optional["trust"] = _base64((255 * trust[::step, ::step]).round().astype(np.uint8))
    if gt_index is not None:
        per_metre = float(np.diff(grid.inverse_depth_to_index([0.0, 1.0]))[0])  # spheres per 1/m
        percent = 100 / grid.num_spheres * per_metre  # the error as in the paper's tables
        truth = grid.index_to_inverse_depth(gt_index)[::step, ::step]
        optional |= {"truth": _base64(_in_steps(truth, per_step)), "percent": percent}
    return optional | {
        "title": title,
        "mode": mode,
        "width": inverse_depth.shape[1],
        "height": inverse_depth.shape[0],
        "phi": np.radians(grid.phi_deg).tolist(),
        "perStep": per_step,
        "steps": _base64(_in_steps(inverse_depth, per_step)),
        "confidence": _base64((255 * np.nan_to_num(depth.confidence[::step, ::step])).round().astype(np.uint8)),
        "doubtful": 255 * DOUBTFUL,
        "low": scale.low,
        "high": scale.high,
        "ticks": scale.ticks(),
        "colors": _base64(scale.bar(256)),
        "maxDepth": min(limits.max_depth, 1e9),
        "minConfidence": limits.min_confidence,
        "picture": "data:image/jpeg;base64," + _jpeg(panorama),
    }


def _in_steps(inverse_depth: NDArray, per_step: float) -> NDArray[np.uint16]:
    """Return inverse depths as steps from 1; 0 is unknown, and nearer than the last step is the last."""
    steps = np.where(np.isfinite(inverse_depth), 1 + np.nan_to_num(inverse_depth) / per_step, 0)
    return steps.round().clip(0, _STEPS + 1).astype("<u2")


def _base64(values: NDArray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _jpeg(picture: NDArray[np.uint8]) -> str:
    height, width = picture.shape[:2]
    if width > _WIDEST:
        picture = cv2.resize(picture, (_WIDEST, round(height * _WIDEST / width)), interpolation=cv2.INTER_AREA)
    pixels = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    return base64.b64encode(cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]).decode()
