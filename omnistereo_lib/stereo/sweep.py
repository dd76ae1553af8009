"""Warping the fisheye images onto concentric spheres (paper, Section III-B and Eq. 1)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import psutil
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn.functional import grid_sample

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid

_D0 = 2.0**-23  # 1/m, the paper's inverse depth of the sphere at infinity
_BLOCK = 16  # spheres warped at a time: their cells are one cache line of the (H, W, N) volume
_MAX_ROWS = 32766  # remap's largest output
OUTSIDE = -1e5  # px, where a ray lands that a camera does not see; NaN coordinates are undefined in remap
_TABLE_BUDGET = 2 << 30  # bytes


@dataclass(frozen=True)
class _Table:
    """Where the rays of one block of spheres land in one camera.

    Only the columns that the camera sees are kept: `width` columns from `start` on, around the seam,
    in one part, or in two where they cross it.
    """

    start: int
    width: int
    parts: list[tuple[int, NDArray[np.float32]]]  # first column, maps (block · H, columns, 2) in pixels

    @property
    def nbytes(self) -> int:
        return sum(maps.nbytes for _, maps in self.parts)


class SphereSweep:
    """Warps the images of a rig onto the N spheres of a grid.

    Where each ray lands depends on the rig and the grid alone, so it is tabulated once and reused for
    every frame: 8 bytes a ray, sphere and camera, for the columns that the camera sees (at the paper's
    1200 × 300 × 192 and four cameras of 220°: 1.3 GB instead of 2.2 GB for all columns). Tables beyond
    `max_table_bytes` are not kept but computed anew for every frame.

    Parameters
    ----------
    rig : Rig
    grid : SphereGrid
    center : array, shape (3,), optional
        Sweep centre in the rig frame, metres; the mean of the camera centres unless given.
    device : torch device
        Where warped images are made: OpenCV's remap on "cpu", grid_sample elsewhere.
    max_table_bytes : int, optional
        2 GiB, or a quarter of the free memory where that is less.

    Attributes
    ----------
    rig : Rig
        The rig moved to the sweep centre: its poses are the inverse of the paper's Θ*.
    grid : SphereGrid
    """

    def __init__(
        self,
        rig: Rig,
        grid: SphereGrid,
        center: ArrayLike | None = None,
        device: torch.device | str = "cpu",
        max_table_bytes: int | None = None,
    ) -> None:
        self.rig = rig.centered(center)
        self.grid = grid
        self.device = torch.device(device)
        if max_table_bytes is None:
            max_table_bytes = min(_TABLE_BUDGET, psutil.virtual_memory().available // 4)
        self.max_table_bytes = max_table_bytes
        self.table_bytes = 0
        self._rays = grid.rays()
        self._tables: dict[tuple[int, int], _Table] = {}
        self._device_maps: dict[tuple[int, int, int], Tensor] = {}

    @cached_property
    def _lens_masks(self) -> list[NDArray[np.uint8]]:
        return [_lens_mask(camera) for camera in self.rig.cameras]

    def pixels(self, camera: int, index: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return where the rays of one sphere land in one camera: Π_i(M(Θ*_i) ρ(p)/d_n) of Eq. 1.

        Parameters
        ----------
        camera : int
        index : float or array of shape (H, W)
            Sphere index n, which may lie between two spheres; as a map, one for each ray, NaN unknown.

        Returns
        -------
        uv : array, shape (H, W, 2), pixels
        valid : bool array, shape (H, W)
        """
        return self.rig.cameras[camera].project(self._directions(camera, index))

    def off_axis(self, camera: int, index: ArrayLike) -> NDArray[np.float64]:
        """Return the angles in [0, π] between a camera's optical axis and the points of one sphere.

        Parameters as in `pixels`; an array of shape (H, W), NaN where the index is unknown.
        """
        x, y, z = np.moveaxis(self._directions(camera, index), -1, 0)
        return np.arctan2(np.hypot(x, y), z)

    def _directions(self, camera: int, index: ArrayLike) -> NDArray[np.float64]:
        """Return the points ρ/d of one sphere in a camera's frame, times d: nothing overflows at infinity."""
        inverse_depth = np.maximum(self.grid.index_to_inverse_depth(index), _D0)[..., None]
        T_cam_rig = self.rig.T_rig_cam[camera].inverse()
        return self._rays @ T_cam_rig.R.T + inverse_depth * T_cam_rig.t

    def warp(self, images: Sequence[ArrayLike], index: ArrayLike) -> list[NDArray[np.float32]]:
        """Return the spherical images S_{i,n} of one sphere, one per camera (Eq. 1).

        Parameters
        ----------
        images : one array per camera, (height, width) or (height, width, 3)
        index : float or array of shape (H, W)
            Sphere index n, which may lie between two spheres; as a map, one for each ray, NaN unknown.

        Returns
        -------
        list of arrays, shape (H, W) or (H, W, 3), float32
            NaN where the camera does not see the ray.
        """
        images = check_images(images, self.rig)
        warped = []
        for camera, image in enumerate(images):
            uv, valid = self.pixels(camera, index)
            maps = np.where(valid[..., None], uv, OUTSIDE).astype(np.float32)
            warped.append(remap(np.asarray(image, np.float32), maps))
        return warped

    def prepare(self, images: Sequence[ArrayLike]) -> list[Tensor]:
        """Return the images as the costs want them: gray, zero mean and unit variance over the lens circle.

        Parameters
        ----------
        images : one array per camera, (height, width) or (height, width, 3) in RGB, uint8 or float

        Returns
        -------
        list of float32 tensors, shape (height, width)

        Raises
        ------
        OmnistereoError
            If there is not one image per camera, or one has the wrong size or is not finite.
        """
        prepared = []
        for image, seen in zip(check_images(images, self.rig), self._lens_masks, strict=True):
            gray = to_gray(image)
            mean, deviation = (float(moment[0, 0]) for moment in cv2.meanStdDev(gray, mask=seen))
            gray = (gray - np.float32(mean)) * np.float32(1 / deviation if deviation > 0 else 1.0)
            prepared.append(torch.from_numpy(gray).to(self.device))
        return prepared

    def blocks(self) -> list[range]:
        """Return the spheres 0 … N - 1 in blocks that are warped together."""
        N = self.grid.num_spheres
        block = max(1, min(_BLOCK, _MAX_ROWS // self.grid.height))
        return [range(n, min(n + block, N)) for n in range(0, N, block)]

    def warp_block(self, prepared: Sequence[Tensor], spheres: range, out: Tensor | None = None) -> Tensor:
        """Warp prepared images onto one of the `blocks`.

        Parameters
        ----------
        prepared : one tensor per camera, as `prepare` returns them
        spheres : range
        out : float32 tensor, shape (cameras, at least len(spheres), H, W), optional
            Written over and returned in part, so that a sweep over many blocks asks for memory once.

        Returns
        -------
        float32 tensor, shape (cameras, len(spheres), H, W)
            NaN where a camera does not see the ray.
        """
        H, W = self.grid.shape
        if out is None:
            out = torch.empty(len(prepared), len(spheres), H, W, device=self.device)
        out = out[:, : len(spheres)].fill_(torch.nan)
        for camera, image in enumerate(prepared):
            self.warp_camera(image, camera, spheres, out[camera])
        return out

    def warp_camera(self, image: Tensor, camera: int, spheres: range, out: Tensor) -> None:
        """Warp one prepared image onto one of the `blocks`, into out (len(spheres), H, W), where it is seen."""
        rows = out.view(-1, self.grid.width)
        for k, (column, maps) in enumerate(self._table(camera, spheres).parts):
            target = rows[:, column : column + maps.shape[1]]
            if self.device.type == "cpu":
                remap(image.numpy(), maps, target.numpy())
            else:
                target.copy_(_grid_sample(image, self._maps_on_device(camera, spheres, k)))

    def visible_columns(self, camera: int, spheres: range) -> tuple[int, int]:
        """Return (start, width) of the columns, around the seam, that a camera sees on a block of spheres."""
        table = self._table(camera, spheres)
        return table.start, table.width

    def _table(self, camera: int, spheres: range) -> _Table:
        key = (camera, spheres.start)
        if key in self._tables:
            return self._tables[key]
        table = self._compute_table(camera, spheres)
        if self.table_bytes + table.nbytes <= self.max_table_bytes:
            self._tables[key] = table
            self.table_bytes += table.nbytes
        return table

    def _compute_table(self, camera: int, spheres: range) -> _Table:
        H, W = self.grid.shape
        maps = np.empty((len(spheres), H, W, 2), np.float32)

        def fill(k: int) -> None:
            uv, valid = self.pixels(camera, spheres[k])
            maps[k] = np.where(valid[..., None], uv, OUTSIDE)

        with ThreadPoolExecutor() as pool:  # NumPy releases the interpreter lock in large operations
            list(pool.map(fill, range(len(spheres))))
        start, width = _circular_span((maps[..., 0] > OUTSIDE).any((0, 1)))
        maps = maps.reshape(-1, W, 2)
        parts = [(a, np.ascontiguousarray(maps[:, a:b])) for a, b in split_at_seam(start, width, W)]
        return _Table(start, width, parts)

    def _maps_on_device(self, camera: int, spheres: range, part: int) -> Tensor:
        """Return one part of a table as a tensor on the device, copied once where the table is kept."""
        key = (camera, spheres.start, part)
        if key in self._device_maps:
            return self._device_maps[key]
        maps = torch.from_numpy(self._table(camera, spheres).parts[part][1]).to(self.device)
        if key[:2] in self._tables:
            self._device_maps[key] = maps
        return maps


def find_device(device: torch.device | str) -> torch.device:
    """Return the device to compute on; under `torchrun` every process takes a GPU of its own.

    Raises
    ------
    OmnistereoError
        If a GPU is asked for and there is none.
    """
    device = torch.device(device)
    if device.type == "cuda":
        if not torch.cuda.is_available():
            raise OmnistereoError('there is no CUDA GPU that PyTorch can use: take device="cpu"')
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", device.index or 0)))
        torch.cuda.set_device(device)
    return device


def check_images(images: Sequence[ArrayLike], rig: Rig) -> list[NDArray]:
    """Return the images as arrays after checking them against the rig's cameras.

    Raises
    ------
    OmnistereoError
        If there is not one image per camera, or one has the wrong size, shape or type or is not finite.
    """
    images = [np.asarray(image) for image in images]
    if len(images) != len(rig):
        raise OmnistereoError(
            f"the rig has {len(rig)} cameras, got {len(images)} images: give one per camera, in order"
        )
    for i, (image, camera) in enumerate(zip(images, rig.cameras, strict=True)):
        width, height = camera.image_size
        if image.shape not in [(height, width), (height, width, 3)]:
            raise OmnistereoError(
                f"image {i + 1} has shape {image.shape}, camera {i + 1} was calibrated for "
                f"({height}, {width}) gray or ({height}, {width}, 3) colour. Was it scaled, cropped or turned?"
            )
        if image.dtype != np.uint8 and not np.issubdtype(image.dtype, np.floating):
            raise OmnistereoError(f"image {i + 1} has type {image.dtype}, expected uint8 or float")
        if image.dtype != np.uint8 and not np.isfinite(image).all():
            raise OmnistereoError(f"image {i + 1} holds NaN or infinite values, expected finite gray values")
    return images


def to_gray(image: NDArray) -> NDArray[np.float32]:
    """Return an image (height, width) or RGB (height, width, 3) as gray float32, by luma (BT.601)."""
    image = np.ascontiguousarray(image, np.float32)
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def _lens_mask(camera: OcamCamera) -> NDArray[np.uint8]:
    """Return 1 for pixels of a camera that carry a picture, else 0, shape (height, width)."""
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    return camera.unproject(pixels)[1].astype(np.uint8)


def _circular_span(seen: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the shortest (start, width) around the circle that covers every True of a row of columns."""
    columns = np.flatnonzero(seen)
    if len(columns) == 0:
        return 0, 0
    gaps = np.diff(np.append(columns, columns[0] + len(seen)))
    widest = int(np.argmax(gaps))
    start = int(columns[(widest + 1) % len(columns)])
    return start, len(seen) - int(gaps[widest]) + 1


def split_at_seam(start: int, width: int, total: int) -> list[tuple[int, int]]:
    """Split the columns start … start + width, taken around the circle, into ranges (first, last + 1)."""
    ranges = [(start, min(start + width, total)), (0, start + width - total)]
    return [(first, last) for first, last in ranges if last > first]


def remap(image: NDArray[np.float32], maps: NDArray[np.float32], out: NDArray[np.float32] | None = None) -> NDArray:
    """Sample an image bilinearly at maps (H, W, 2), NaN outside it. OpenCV 5 does this without rounding."""
    nan = (np.nan,) * 4
    return cv2.remap(image, maps, None, cv2.INTER_LINEAR, out, cv2.BORDER_CONSTANT, nan)


def _grid_sample(image: Tensor, maps: Tensor) -> Tensor:
    """Do what `remap` does, in torch on any device."""
    height, width = image.shape
    scale = torch.tensor([2.0 / (width - 1), 2.0 / (height - 1)], device=maps.device)
    sampled = grid_sample(image[None, None], (maps * scale - 1.0)[None], align_corners=True)[0, 0]
    return sampled.masked_fill(maps[..., 0] == OUTSIDE, torch.nan)
