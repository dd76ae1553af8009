"""Pictures of a depth panorama: the sharp panorama, frames of films."""

from __future__ import annotations

from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import atomic_write
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.pictures import write_image
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.blend import blended_panorama, finer_index, strips
from omnistereo_tools.output.colors import BACKGROUND, ColorScale
from omnistereo_tools.output.render import around, draw_surfaces

_SOFT = 0.2  # of trust, from not faded to faded
FILM = 1920, 1080  # px, of a frame of a film: width, height
_SHARP = 1280  # px, about, of the panorama that the surfaces in it have their colours from
_STRIP_PX = 44  # height of the note and the scale below the panoramas
# Of its eye: nearest depths from the rig; radians. What lies below ±45° is out of the frame.
AWAY, _TILT = 2.0, 0.32
_INK, _STRIPE = (0xE8,) * 3, 0x50
#: DejaVu Sans, in which all pictures are lettered
FONT = str(distribution("matplotlib").locate_file("matplotlib/mpl-data/fonts/ttf/DejaVuSans.ttf"))

_GPANO = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
    'syntax-ns#"><rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/'
    'panorama/" GPano:ProjectionType="equirectangular" {}/></rdf:RDF></x:xmpmeta>'
)


def sharp_panorama(
    depth: Depth, width: int, gains: NDArray[Any] | None = None
) -> NDArray[np.uint8]:
    """Return the blended panorama with about `width` columns, uint8 RGB; unknown is black.

    The images hold more detail than the depth, so each ray is divided into several; see
    `finer_index`.

    Args:
        gains: Of `estimate_gains`, None: those of the images.
    """
    return as_picture(blended_panorama(depth, gains, finer(depth, width)))


def as_picture(blended: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a blended panorama as uint8 RGB; unknown is black."""
    parts = [np.nan_to_num(rows).round().astype(np.uint8) for rows in strips(blended)]
    pixels = np.concatenate(parts)
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, -1)


def draw_frame(
    depth: Depth,
    gains: NDArray[Any] | None,
    trust: NDArray[Any],
    scale: ColorScale,
    note: str,
    turn: float,
) -> NDArray[np.uint8]:
    """Draw a frame as live and on film: its surfaces seen from behind the rig, below them the
    panorama, its depth in colours beside it, a note and the scale. What is doubtful is faded.

    Args:
        gains: As of `sharp_panorama`.
        trust: Of `trust.trust`, (H, W).
        turn: Of the eye around the rig, radians; 0 looks ahead.

    Returns:
        uint8 array, RGB, as large as `FILM`; `panes` says where the panoramas are
    """
    panorama = sharp_panorama(depth, _SHARP, gains)
    index, _ = finer_index(depth, finer(depth, _SHARP))
    fine_trust = cv2.resize(trust.astype(np.float32), index.shape[::-1])
    doubts = (0.5 + (DOUBTFUL - fine_trust) / _SOFT).clip(0, 1)
    colors = scale.colorize(depth.grid.index_to_inverse_depth(index), doubts)
    eye = around(AWAY * depth.grid.min_depth, turn, _TILT)
    view = draw_surfaces(depth, panorama, doubts, eye, (FILM[0], panes(depth.grid)[0]))
    rows, columns = np.ogrid[: view.shape[0], : view.shape[1]]
    view[((rows + columns) % 16 < 3) & (view == BACKGROUND).all(-1)] = _STRIPE
    return compose(view, panorama, colors, scale, f"{note}. Faded: doubtful, striped: not seen")


def panes(grid: SphereGrid) -> tuple[int, int]:
    """Return first row and height, px, of the panoramas of `draw_frame`: two side by side."""
    height = min(round(FILM[0] / 2 * grid.height / grid.width), FILM[1] // 2) // 2 * 2
    return FILM[1] - _STRIP_PX - height, height


def compose(
    view: NDArray[np.uint8],
    panorama: NDArray[np.uint8],
    colors: NDArray[np.uint8],
    scale: ColorScale,
    note: str,
) -> NDArray[np.uint8]:
    """Put together a frame of a film from a view and two panoramas; see `draw_frame`."""
    half, height = FILM[0] // 2, FILM[1] - _STRIP_PX - len(view)
    pair = [
        cv2.resize(one, (half, height), interpolation=cv2.INTER_AREA) for one in (panorama, colors)
    ]
    strip = np.full((_STRIP_PX, FILM[0], 3), BACKGROUND, np.uint8)
    strip[4:18, half:] = cv2.resize(scale.bar(256), (half, 14), interpolation=cv2.INTER_LINEAR)
    for at, label in scale.ticks():
        _write(strip, label, (half + int(np.clip(at * half - 20, 4, half - 84)), _STRIP_PX - 4))
    _write(strip, note, (12, _STRIP_PX - 15))
    return np.vstack([view, np.hstack(pair), strip])


def write_panorama(path: Path, image: NDArray[Any], grid: SphereGrid) -> None:
    """Write a panorama as JPEG, with the part of the sphere that it shows for 360° viewers (GPano),
    without a heading, on which viewers disagree.
    """
    write_image(path, image)
    (low, high), (height, width) = grid.phi_deg, grid.shape
    whole = round(height * 180 / (high - low))
    sizes = {"FullPanoWidth": width, "FullPanoHeight": whole, "CroppedAreaImageWidth": width}
    sizes |= {"CroppedAreaImageHeight": height, "CroppedAreaLeft": 0}
    sizes |= {"CroppedAreaTop": round((low + 90) / 180 * whole)}
    tags = " ".join(f'GPano:{name}Pixels="{value}"' for name, value in sizes.items())
    segment = b"http://ns.adobe.com/xap/1.0/\0" + _GPANO.format(tags).encode()
    jpeg = path.read_bytes()
    with atomic_write(path) as temporary:
        # behind the two bytes that begin each JPEG
        head = jpeg[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big")
        temporary.write_bytes(head + segment + jpeg[2:])


def in_millimetres(depth: NDArray[Any]) -> NDArray[np.uint16]:
    """Return depth in metres as whole millimetres; 0 where it is unknown or beyond 65 m."""
    steps = np.nan_to_num(1000 * depth)
    return np.where(steps < 65535, steps.round(), 0).astype(np.uint16)


def finer(depth: Depth, width: int) -> int:
    """Return the factor by which the panorama of a depth is enlarged to about `width` columns."""
    return max(1, round(width / depth.grid.width))


def _write(picture: NDArray[np.uint8], text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, _INK, cv2.FontFace(FONT), 24, 400)
