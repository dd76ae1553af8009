"""Sphere sweep: warp the images onto concentric spheres (paper, Section III-B and Eq. 1)."""

import math
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from threading import Lock
from typing import Any, TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from omnistereo_lib import reference
from omnistereo_lib.errors import OmnistereoError, check_type
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import D0, Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.lazy import hold_at_fork, lazy_property
from omnistereo_lib.stereo.columns import circular_span, split_at_seam
from omnistereo_lib.stereo.device import BLOCK, available_memory, check_memory, select_device
from omnistereo_lib.stereo.threads import map_threads

# The output of cv2.remap may be so wide and so high.
_MAX_SIDE = 32766
# Pixel coordinate of rays that are not visible. It lies far outside of any image, so that cv2.remap
# reads its border there, NaN; a NaN coordinate is undefined in cv2.remap.
OUTSIDE = -1e5
# In bytes: tables beyond it are computed anew for every frame.
_LUT_BUDGET = 2 << 30
# One table is built at a time: it takes all cores and much memory.
_LUT_LOCK = Lock()
hold_at_fork(_LUT_LOCK)

# Pixel coordinates of the rays of one block of spheres in one camera, as (first column, maps of
# shape (H, columns · block, 2)): the pixels of one ray on neighbouring spheres are close together
# in the image, so they follow each other. Only the visible columns are stored: in one part, or in
# two if they cross the ±180° seam.
_LookupTable = list[tuple[int, Tensor]]
# σ of `blur_px`, the mask, the mask blurred
_Blurring = tuple[float, NDArray[np.float32], NDArray[np.float32]]
_Kept = TypeVar("_Kept")


class SphereSweep:
    """Warps the images of a rig onto the N spheres of a grid (paper, Section III-B).

    The pixel coordinates of the rays depend only on the rig and the grid, so they are kept in
    lookup tables (LUT) from frame to frame: 8 bytes per ray, sphere and camera for the visible
    columns. At 1200 × 300 × 192 and four cameras of 220° that is 1.3 GB. Tables beyond 2 GiB, or a
    quarter of the available memory, are recomputed for every frame.

    Args:
        center ((3,), metres): Sweep centre in the rig frame. Default: the mean of the cameras.
        device: Device of tables and warped images: cv2.remap on "cpu", grid_sample elsewhere.
        keep_tables: False: for a single frame, whose tables would only fill the memory.

    Raises:
        OmnistereoError: If the panorama is larger than OpenCV can sample, 32766 pixels a side, if
            memory cannot hold what any method takes of the grid, or if there is no such device.

    Attributes:
        rig: The rig with its origin at the sweep centre: its poses are the inverse of Θ*.

    >>> frame = osl.load_dataset("data_samples/sunny", split="test")[0]
    >>> sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(64, 16, num_spheres=16, min_depth=1.65))
    >>> bool(np.allclose(sweep.rig.centers.mean(axis=0), 0))  # the origin is the sweep centre
    True
    """

    def __init__(
        self,
        rig: Rig,
        grid: SphereGrid,
        center: ArrayLike | None = None,
        device: torch.device | str = "cpu",
        keep_tables: bool = True,
    ) -> None:
        check_type(rig, Rig, "rig")
        check_type(grid, SphereGrid, "grid")
        if max(grid.shape) > _MAX_SIDE:
            raise OmnistereoError(
                f"the panorama is {grid.width} × {grid.height}; expected at most {_MAX_SIDE} a side"
            )
        self.rig = rig.recentered(center)
        self.grid = grid
        self.device = select_device(device)
        check_memory(len(rig), grid, self.device, volume=self.device.type != "cpu")
        self.keep_tables = keep_tables
        most = min(_LUT_BUDGET, available_memory(self.device) // 4)
        self._most_bytes = most if keep_tables else 0
        self._rays = grid.rays()
        self._luts: dict[tuple[int, int], _LookupTable] = {}
        # (start, width) of the visible columns
        self._spans: dict[tuple[int, int], tuple[int, int]] = {}
        self._kept: dict[Hashable, Any] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is kept: a copy, or a sweep in another process, makes its own."""
        return self.__dict__ | {"_luts": {}, "_spans": {}, "_kept": {}}

    def keep(self, key: Hashable, make: Callable[[], _Kept]) -> _Kept:
        """Return make(), called once for this sweep: what a cost keeps from frame to frame."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def with_poses(self, T_rig_cam: Sequence[Pose]) -> "SphereSweep":
        """Return a sweep of the same cameras with other poses, around their mean centre.

        Cameras that stay where they are share their tables.
        """
        other = copy(self)
        other.rig = self.rig.with_poses(T_rig_cam).recentered()
        poses = zip(self.rig.T_rig_cam, other.rig.T_rig_cam, strict=True)
        kept = {
            i
            for i, (a, b) in enumerate(poses)
            if np.array_equal(a.R, b.R) and np.array_equal(a.t, b.t)
        }
        other._luts = {key: lut for key, lut in self._luts.items() if key[0] in kept}
        other._spans = {key: span for key, span in self._spans.items() if key[0] in kept}
        other._kept = {}
        return other

    @property
    def lut_bytes(self) -> int:
        """Size of the lookup tables that are kept."""
        return sum(maps.nbytes for lut in self._luts.values() for _, maps in lut)

    @lazy_property
    def _image_masks(self) -> list[NDArray[np.uint8]]:
        """For each camera 1 where its pixels are valid, else 0, shape (height, width)."""
        return [camera.visible_pixels().astype(np.uint8) for camera in self.rig.cameras]

    def project_sphere(
        self, camera: int, index: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Project the points of one sphere into one camera: Π_i(M(Θ*_i) ρ(p)/d_n) of Eq. 1.

        Args:
            index (float or array of shape (H, W)): Sphere index n, integer or fractional; as an
                array, one index per ray, NaN unknown.

        Returns:
            uv: array, shape (H, W, 2), pixels
            valid: bool array, shape (H, W)
        """
        return self.rig.cameras[camera].project(self._directions(camera, index))

    def off_axis_angles(self, camera: int, index: ArrayLike) -> NDArray[np.float64]:
        """Return the angles in [0, π] between a camera's optical axis and the points of one sphere.

        Parameters as in `project_sphere`; shape (H, W), NaN where the index is unknown.
        """
        x, y, z = np.moveaxis(self._directions(camera, index), -1, 0)
        return np.arctan2(np.hypot(x, y), z)

    def _directions(self, camera: int, index: ArrayLike) -> NDArray[np.float64]:
        """Return the points ρ/d of one sphere in the camera frame, times d; see `Rig.towards`."""
        return self.rig.towards(camera, self._rays, self.grid.index_to_inverse_depth(index))

    def warp(
        self, images: Frame | Sequence[ArrayLike], index: ArrayLike
    ) -> list[NDArray[np.float32]]:
        """Return the spherical images S_{i,n} of one sphere, one per camera (Eq. 1).

        Args:
            images: A frame, or one array per camera, (height, width) or (height, width, 3).
            index (float or array of shape (H, W)): As in `project_sphere`.

        Returns:
            list of arrays, shape (H, W) or (H, W, 3), float32: NaN where unseen.
        """
        warped = []
        for camera, image in enumerate(Frame.of(self.rig, images).images):
            # Eq. 1: the image is read where the points of the sphere land in it.
            uv, valid = self.project_sphere(camera, index)
            maps = np.where(valid[..., None], uv, OUTSIDE).astype(np.float32)
            warped.append(remap(np.asarray(image, np.float32), maps))
        return warped

    @lazy_property
    def _blurs(self) -> list[_Blurring]:
        """What `normalize_images` needs of each camera."""
        spacing = 360 / self.grid.width
        sigmas = [blur_px(camera.pixels_per_degree * spacing) for camera in self.rig.cameras]
        masks = [mask.astype(np.float32) for mask in self._image_masks]
        return [
            (s, mask, np.maximum(blur(mask, s), 1e-6))
            for s, mask in zip(sigmas, masks, strict=True)
        ]

    def normalize_images(self, images: Frame | Sequence[ArrayLike]) -> list[Tensor]:
        """Return the images in gray, no finer than the panorama, normalised over the image circle.

        A panorama coarser than the images takes a sample from several pixels of them, so they are
        blurred first, or it would alias; see `blur_px`. Then each gets zero mean and unit variance.

        Args:
            images: A frame, or one array per camera, (height, width) or (height, width, 3).

        Returns:
            list of float32 tensors, shape (height, width)

        Raises:
            OmnistereoError: If there is not one image per camera, or of a wrong size or not finite.
        """

        def normalize(gray: NDArray[Any], mask: NDArray[np.uint8], blurring: _Blurring) -> Tensor:
            sigma, inside, weight = blurring
            # Within the image circle: gray values times the mask, and the mask itself, are blurred;
            # their quotient is a mean over visible pixels alone.
            if sigma:
                gray = blur(gray * inside, sigma)
                gray /= weight
            mean, deviation = (float(moment[0, 0]) for moment in cv2.meanStdDev(gray, mask=mask))
            # Zero mean and unit variance; not in place, since it may be the caller's image.
            gray = gray - np.float32(mean)
            gray *= np.float32(1 / deviation if deviation > 0 else 1.0)
            return torch.from_numpy(gray).to(self.device)

        return list(
            map_threads(normalize, Frame.of(self.rig, images).gray, self._image_masks, self._blurs)
        )

    def blocks(self) -> list[range]:
        """Return the sphere indices 0 to N - 1 in blocks that are warped together."""
        N = self.grid.num_spheres
        # The spheres of a block share one row of cv2.remap's output, so W · B is limited.
        block = max(1, min(BLOCK, _MAX_SIDE // self.grid.width))
        return [range(n, min(n + block, N)) for n in range(0, N, block)]

    def warp_block(
        self, normalized: Sequence[Tensor], spheres: range, out: Tensor | None = None
    ) -> Tensor:
        """Warp normalized images onto one of the `blocks` (Eq. 1).

        Args:
            normalized: one tensor per camera, from `normalize_images`
            out (float32 tensor, shape (cameras, H, W, len(spheres))): Buffer to overwrite, so that
                a sweep over many blocks allocates once.

        Returns:
            float32 tensor, shape (cameras, len(spheres), H, W): NaN where the ray is not visible to
                the camera; a view of a tensor with the shape of `out`.
        """
        if out is None:
            shape = len(normalized), *self.grid.shape, len(spheres)
            out = torch.empty(shape, dtype=torch.float32, device=self.device)
        for camera, image in enumerate(normalized):
            self.warp_camera(image, camera, spheres, out[camera])
        return out.permute(0, 3, 1, 2)

    def warp_camera(self, image: Tensor, camera: int, spheres: range, out: Tensor) -> None:
        """Warp one normalized image onto one of the `blocks`: overwrite out (H, W, B)."""
        H, W, B = out.shape
        rows = out.view(H, W * B)
        on_cpu = self.device.type == "cpu"
        # The visible columns: one part of the panorama, or two if they cross the seam. One row of
        # the output holds all spheres of all columns, so one call warps the whole block.
        for column, maps in self._lookup_table(camera, spheres):
            target = rows[:, column * B : column * B + maps.shape[1]]
            if on_cpu:
                remap(image.numpy(), maps.numpy(), target.numpy())
            else:
                target.copy_(reference.sample(image[None], maps)[0])
        # All other columns are those that the camera does not see.
        start, width = self._spans[camera, spheres.start]
        for first, stop in split_at_seam((start + width) % W, W - width, W):
            (out.numpy() if on_cpu else out)[:, first:stop] = np.nan

    def visible_columns(self, camera: int, spheres: range) -> tuple[int, int]:
        """Return (start, width) of the columns, around the seam, that a camera sees on a block."""
        if (camera, spheres.start) not in self._spans:
            self._lookup_table(camera, spheres)
        return self._spans[camera, spheres.start]

    def _lookup_table(self, camera: int, spheres: range) -> _LookupTable:
        key = (camera, spheres.start)
        if key in self._luts:
            return self._luts[key]
        # Tables are kept as long as they fit; one that does not is used and forgotten.
        with _LUT_LOCK:
            lut = self._compute_lut(camera, spheres)
            size = sum(maps.nbytes for _, maps in lut)
            if self.lut_bytes + size <= self._most_bytes:
                self._luts[key] = lut
        return lut

    def _compute_lut(self, camera: int, spheres: range) -> _LookupTable:
        H, W = self.grid.shape
        maps = torch.empty(H, W, len(spheres), 2, dtype=torch.float32, device=self.device)
        # Project the rays onto every sphere of the block.
        if self.device.type == "cpu":
            table = maps.numpy()

            def fill(k: int) -> None:
                uv, valid = self.project_sphere(camera, spheres[k])
                table[:, :, k] = uv
                table[~valid, k] = OUTSIDE

            # More threads would wait for the interpreter's lock.
            with ThreadPoolExecutor(torch.get_num_threads()) as pool:
                list(pool.map(fill, range(len(spheres))))
        else:
            for k, n in enumerate(spheres):
                uv, valid = self._project_by_torch(camera, n)
                maps[:, :, k] = uv.masked_fill_(~valid[..., None], torch.nan)
        # Keep the columns that are visible on any of them.
        # This is false for NaN, too, which the device's tables have in place of OUTSIDE.
        visible = (maps[..., 0] > OUTSIDE).any(2).any(0).cpu().numpy()
        start, width = circular_span(visible)
        self._spans[camera, spheres.start] = start, width
        return [(a, maps[:, a:b].reshape(H, -1, 2)) for a, b in split_at_seam(start, width, W)]

    def _project_by_torch(self, camera: int, n: int) -> tuple[Tensor, Tensor]:
        """Return what `project_sphere` does, as tensors that are computed on the device."""
        rays = self.keep("rays", lambda: torch.from_numpy(self._rays).to(self.device))
        T_cam_rig = self.rig.T_rig_cam[camera].inverse()
        R, t = (torch.tensor(values, device=self.device) for values in (T_cam_rig.R, T_cam_rig.t))
        inverse_depth = max(float(self.grid.index_to_inverse_depth(n)), D0)
        return self.rig.cameras[camera].project(rays @ R.T + inverse_depth * t)


def blur_px(spacing: float) -> float:
    """Return σ in pixels of the Gaussian that keeps samples `spacing` pixels apart from aliasing.

    The usual choice is half the spacing. An image is about as sharp as its pixels allow, σ = 0.5,
    and variances add. 0: none is needed.
    """
    return 0.5 * math.sqrt(spacing**2 - 1) if spacing > 1.1 else 0.0


def blur(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Blur an image by a Gaussian; σ = 0 returns it as it is."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32) if sigma else image


def remap(
    image: NDArray[np.float32], maps: NDArray[np.float32], out: NDArray[np.float32] | None = None
) -> NDArray[Any]:
    """Sample an image bilinearly at maps (H, W, 2), NaN outside.

    OpenCV 5 does not round the coordinates.
    """
    nan = (np.nan,) * 4
    # maps holds both coordinates; OpenCV's hints do not know that the second map may be None
    no_second: Any = None
    return np.asarray(
        cv2.remap(image, maps, no_second, cv2.INTER_LINEAR, out, cv2.BORDER_CONSTANT, nan),
        np.float32,
    )
