"""Pictures of a depth panorama: the sharp panorama, depth in colours, points from outside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.files import atomic_write
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.pictures import write_image
from omnistereo_lib.stereo.depth import Depth
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.blend import blended_panorama, finer_index
from omnistereo_tools.output.render import BACKGROUND, around, draw_surfaces

_FADE, _GRAY = 0.65, 0x80  # of what is doubtful, towards
_SOFT = 0.2  # of trust, from not faded to faded
_NEAREST = 0.1  # metres in front of the eye
_LARGEST = 7  # px of a point: nearer ones would hide what is behind them
FILM = 1920, 1080  # px, of a frame of a film: width, height
_SHARP = 1280  # px, about, of the panorama that the surfaces in it have their colours from
_STRIP_PX = 44  # height of the note and the scale below the panoramas
_AWAY, _TILT = 4.5, 0.32  # of its eye: nearest depths from the rig; radians
_INK = (0xE8,) * 3


def colorize_depth(inverse_depth: ArrayLike, grid: SphereGrid) -> NDArray[np.uint8]:
    """Return a colour image of inverse depth: near is bright and warm, far is dark, unknown is
    striped grey.

    Args:
        inverse_depth: array, shape (H, W), 1/m, NaN unknown
        grid: The nearest sphere has the brightest colour.

    Returns:
        uint8 array, shape (H, W, 3), RGB
    """
    inverse_depth = np.asarray(inverse_depth)
    level = np.clip(256 * np.nan_to_num(inverse_depth) * grid.min_depth, 0, 255).astype(np.uint8)
    # The lightness of Inferno is monotonic, so it works in grey print and for colour-blind readers.
    colors = cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    rows, columns = np.nonzero(~np.isfinite(inverse_depth))
    colors[rows, columns] = np.where((rows + columns) // 4 % 2, 170, 200)[:, None]
    return np.asarray(colors, np.uint8)


def faded(
    colors: NDArray[np.uint8], doubtful: NDArray[Any], towards: int = BACKGROUND
) -> NDArray[np.uint8]:
    """Return colours (..., 3), drawn towards a gray value as they are doubtful (...), 0 to 1."""
    return (colors + (_FADE * doubtful[..., None]) * (np.float32(towards) - colors)).astype(
        np.uint8
    )


_GPANO = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-'
    'syntax-ns#"><rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/'
    'panorama/" GPano:ProjectionType="equirectangular" {}/></rdf:RDF></x:xmpmeta>'
)


@dataclass(frozen=True)
class ColorScale:
    """Range of inverse depth in 1/m that the colours of a depth picture are stretched to."""

    low: float
    high: float

    @classmethod
    def of(cls, inverse_depth: NDArray[Any]) -> ColorScale:
        """Return the range without the outermost percent on either side."""
        known = inverse_depth[np.isfinite(inverse_depth)]
        low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
        low = 0.0 if low < 0.02 * high else float(low)  # the sky is part of the scale
        return cls(low, float(max(high, low + 1e-3)))

    def colorize(
        self, inverse_depth: NDArray[Any], doubtful: NDArray[Any] | None = None
    ) -> NDArray[np.uint8]:
        """Return inverse depth (H, W) in colours, (H, W, 3) RGB, doubtful rays faded."""
        colors = colorize_depth(inverse_depth - self.low, self._grid)
        return colors if doubtful is None else faded(colors, doubtful, _GRAY)

    def bar(self, width: int) -> NDArray[np.uint8]:
        """Return the colours from `low` to `high` as a picture of one row, (1, width, 3) RGB."""
        return colorize_depth(np.linspace(0, self.high - self.low, width)[None], self._grid)

    def ticks(self) -> list[tuple[float, str]]:
        """Return places in [0, 1] and labels in metres, far to near, at least a twentieth apart."""
        depths = [
            np.inf,
            *(digit * 10.0**k for k in (2, 1, 0, -1, -2) for digit in (7, 5, 4, 3, 2, 1.5, 1)),
        ]
        chosen: list[tuple[float, str]] = []
        for depth in depths:
            at = (1 / depth - self.low) / (self.high - self.low)
            if -1e-6 <= at <= 1 and (not chosen or at - chosen[-1][0] > 1 / 20):
                chosen.append((float(at), "∞" if depth == np.inf else f"{depth:g} m"))
        return chosen

    @property
    def _grid(self) -> SphereGrid:
        """A grid, of which `colorize_depth` reads the nearest depth only."""
        return SphereGrid(2, 2, min_depth=1 / (self.high - self.low))


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
    pixels = np.nan_to_num(blended).round().astype(np.uint8)
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
    panorama, (index, _) = (
        sharp_panorama(depth, _SHARP, gains),
        finer_index(depth, finer(depth, _SHARP)),
    )
    fine_trust = cv2.resize(
        trust.astype(np.float32), index.shape[::-1], interpolation=cv2.INTER_LINEAR
    )
    doubts = (0.5 + (DOUBTFUL - fine_trust) / _SOFT).clip(0, 1)
    colors = scale.colorize(depth.grid.index_to_inverse_depth(index), doubts)
    eye = around(_AWAY * depth.grid.min_depth, turn, _TILT)
    view = draw_surfaces(depth, panorama, doubts, eye, (FILM[0], panes(depth.grid)[0]))
    return compose(view, panorama, colors, scale, f"{note}. Faded: doubtful, striped: no depth")


def panes(grid: SphereGrid) -> tuple[int, int]:
    """Return the first row and the height of the panoramas in `draw_frame`, px: two side by
    side.
    """
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
        _write(strip, label, (half + int(np.clip(at * half - 16, 4, half - 52)), _STRIP_PX - 6))
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
    cv2.putText(picture, text, place, _INK, cv2.FontFace("sans"), 20, 400)


def draw_points(
    points: NDArray[Any],
    colors: NDArray[Any],
    size: tuple[int, int],
    eye: tuple[float, float, float] | None = None,
) -> NDArray[np.uint8]:
    """Draw a point cloud (M, 3) in metres, rig frame.

    Args:
        colors: uint8 array, shape (M, 3), RGB
        size: (width, height) in pixels
        eye: Where it is seen from, towards the sweep centre, metres; not straight above. Default:
            from above and behind the rig, at a distance that suits the cloud.

    Returns:
        uint8 array, shape (height, width, 3), RGB
    """
    width, height = size
    picture = np.full((height, width, 3), BACKGROUND, np.uint8)
    if len(points) == 0:
        return picture
    target, nearest = np.zeros(3), _NEAREST
    place = np.asarray(eye, np.float64)
    if eye is None:
        typical = float(np.percentile(np.linalg.norm(points, axis=-1), 60))
        # y points down
        place, target = typical * np.array([0.35, -0.9, -1.3]), typical * np.array([0.0, 0.1, 0.3])
        # a wall between the eye and the rig would hide the scene
        nearest = max(_NEAREST, 0.35 * typical)
    x, y, z = _axes(target - place) @ (points - place).T
    order = np.argsort(-z)
    order = order[z[order] > nearest]
    focal = 0.62 * width
    u, v = width / 2 + focal * x[order] / z[order], height / 2 + focal * y[order] / z[order]
    reach = np.linalg.norm(points[order], axis=-1) / z[order]
    spacing = 2 * np.pi / np.sqrt(8 * len(points))  # about the angle between rays
    sides = np.clip(np.ceil(focal * spacing * reach), 1, _LARGEST).astype(int)
    depth = np.full((height, width), np.inf)
    left, top, far = u - sides / 2, v - sides / 2, z[order]
    for row, column in np.ndindex(_LARGEST, _LARGEST):
        some = np.flatnonzero(sides > max(row, column))
        at_u = np.floor(left[some] + column).astype(int)
        at_v = np.floor(top[some] + row).astype(int)
        drawn = (at_u >= 0) & (at_u < width) & (at_v >= 0) & (at_v < height)
        drawn[drawn] = far[some[drawn]] < depth[at_v[drawn], at_u[drawn]]
        where = at_v[drawn], at_u[drawn]  # of several points the last, and so the nearest, stays
        picture[where], depth[where] = colors[order[some[drawn]]], far[some[drawn]]
    return picture


def _axes(towards: NDArray[Any]) -> NDArray[np.float64]:
    """Return the axes of a camera that looks in a direction, right, down, forward, as rows."""
    forward = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])
