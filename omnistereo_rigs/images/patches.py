"""Least-squares matching: observations to a tenth of a pixel, from patches of the images."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Floats
from omnistereo_rigs.images.features import Tracks, in_gray
from omnistereo_rigs.images.track_bundle import TrackBundle

# In pixels: patches are 13 × 13.
_HALF = 6
_STEPS = 4
# A patch matches if its correlation with the reference is at least this …
_LEAST_CORRELATION = 0.88
# … and it lies at most so many pixels from where the bundle puts the point.
_MOST_SHIFT = 2.0
# So many are matched at a time by a thread: fewer wait for each other.
_TOGETHER = 512
# A plane that is seen flatter than by this sine is not tried.
_SLANTED = 0.15


def refine_tracks(bundle: TrackBundle, images: Sequence[Sequence[NDArray[np.uint8]]]) -> Tracks:
    """Match patches anew: a small plane at a point looks the same in all cameras that see it.

    The camera that sees the point nearest to its axis is the reference, whose observation becomes
    where the bundle puts the point. In the others shift, affine map, gain and offset are adjusted.
    Patches that do not match are dropped.

    Args:
        images: images[frame][camera]
    """
    matcher = _PatchMatcher(bundle, images)
    parts = [slice(k, k + _TOGETHER) for k in range(0, max(len(matcher.others), 1), _TOGETHER)]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = [*threads.map(matcher.match, parts)]
    shift, good = (np.concatenate(one) for one in zip(*found, strict=True))
    tracks = bundle.tracks
    pixels = bundle.residuals() + tracks.pixels  # where the bundle puts them
    pixels[matcher.others] += shift
    keep = np.zeros(len(pixels), bool)
    keep[matcher.others[good]] = keep[matcher.reference[tracks.point[matcher.others[good]]]] = True
    return Tracks(tracks.camera, tracks.frame, tracks.point, pixels).select(keep)


class _PatchMatcher:
    """The patches (P, 169) of all observations but those of the reference cameras."""

    def __init__(self, bundle: TrackBundle, images: Sequence[Sequence[NDArray[np.uint8]]]) -> None:
        self.bundle, tracks = bundle, bundle.tracks
        self.cameras = bundle.adjusted_rig().cameras
        pictures = ((f, c, image) for f, row in enumerate(images) for c, image in enumerate(row))
        self.layers = {(f, c): _with_slopes(image) for f, c, image in pictures}
        axes = bundle.R[tracks.camera][:, :, 2]
        off_axis = np.einsum("mi,mi->m", axes, bundle.points[tracks.point, :3])
        order = np.lexsort((-off_axis, tracks.point))
        # Of each point, the observation nearest to the axis of its camera comes first: that is the
        # reference.
        self.reference = order[np.concatenate([[True], np.diff(tracks.point[order]) > 0])]
        self.others = np.setdiff1d(np.arange(len(tracks.point)), self.reference)
        self.frame, self.camera = tracks.frame[self.others], tracks.camera[self.others]
        point = tracks.point[self.others]
        self.reference_camera = tracks.camera[self.reference][point]
        self.u, self.inverse = bundle.points[point, :3], bundle.points[point, 3]
        steps = np.arange(-_HALF, _HALF + 1)
        self.offsets = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) / _HALF
        # A Gaussian window: the middle of a patch counts most.
        window = np.exp(-(self.offsets**2).sum(axis=1) / 0.72)
        self.window = window / window.sum()

    def match(self, part: slice) -> tuple[Floats, NDArray[np.bool_]]:
        """Return what `adjust` does, of some of the patches."""
        some = copy(self)
        for name in ("frame", "camera", "reference_camera", "u", "inverse"):
            setattr(some, name, getattr(self, name)[part])
        return some.adjust(some.best_planes())

    def best_planes(self) -> Floats:
        """Return the normal (P, 3) that matches best: facing, level, or one of two walls."""
        u, down = self.u, np.array([0.0, 1.0, 0.0])
        flat, aside = u * [1.0, 0.0, 1.0], np.cross(down, u)
        normals, best = u.copy(), np.full(len(u), -1.0)
        for plane in (u, np.tile(down, (len(u), 1)), flat + 0.9 * aside, flat - 0.9 * aside):
            slanted = np.abs(np.einsum("pi,pi->p", plane, u)) < _SLANTED
            plane = np.where(slanted[:, None], u, plane)
            here = self._sample(self.reference_camera, self._pixels(self.reference_camera, plane))
            there = self._sample(self.camera, self._pixels(self.camera, plane))
            match = self._correlation(here, there)
            # The plane that faces the rig comes first, and another has to be clearly better.
            better = match > best + 0.02
            best[better], normals[better] = match[better], plane[better]
        return normals

    def adjust(self, normals: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the shift of each patch in pixels (P, 2), and which of them match."""
        target = self._sample(self.reference_camera, self._pixels(self.reference_camera, normals))
        start = self._pixels(self.camera, normals)
        shift, affine = np.zeros((len(start), 2)), np.zeros((len(start), 2, 2))
        gain = np.ones(len(start))
        for _ in range(_STEPS):
            # Gauss-Newton (Lucas and Kanade 1981; Grün 1985). The target is gain · seen(x + shift +
            # A offset) + offset, and the slopes of the image are the derivatives by shift and A.
            where = start + shift[:, None] + self.offsets @ affine
            seen, du, dv = (self._sample(self.camera, where, layer) for layer in range(3))
            x, y = self.offsets.T
            slopes = [du, dv, du * x, dv * x, du * y, dv * y, seen, np.ones_like(seen)]
            J = np.stack(slopes, axis=-1).astype(float)
            weighted = J * self.window[:, None]
            # Each step is damped, that of the affine map most: a patch without texture stays where
            # it is.
            normal = np.swapaxes(weighted, 1, 2) @ J + np.diag([1e-3, 1e-3, 3, 3, 3, 3, 1e-6, 1e-6])
            right = np.einsum("pmi,pm->pi", weighted, target)
            solved = np.linalg.solve(normal, right[..., None])[..., 0]
            gain = solved[:, 6]
            # The slopes were taken without the gain, so divide by it.
            step = np.clip(solved[:, :6] / np.maximum(gain, 0.2)[:, None], -1, 1)
            shift, affine = shift + step[:, :2], affine + step[:, 2:].reshape(-1, 2, 2)
        seen = self._sample(self.camera, start + shift[:, None] + self.offsets @ affine)
        good = (self._correlation(target, seen) > _LEAST_CORRELATION) & (gain > 0.3) & (gain < 3)
        good &= np.linalg.norm(shift, axis=1) < _MOST_SHIFT
        good &= np.abs(affine).max(axis=(1, 2)) < _HALF / 2
        return shift, good

    def _pixels(self, camera: NDArray[np.int64], normals: Floats) -> Floats:
        """Return where cameras (P,) see patches of planes through the points, (P, 169, 2)."""
        bundle, u = self.bundle, self.u
        right = np.cross([0.0, 1.0, 0.0], u)
        right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-9)
        size = _HALF / np.degrees(self.cameras[0].pixels_per_degree)
        x, y = size * self.offsets.T[:, None, :, None]
        rays = u[:, None] + x * right[:, None] + y * np.cross(u, right)[:, None]
        # On a plane the inverse distance along a ray is linear in the ray: ρ(r) = ρ(u) (r · n) / (u
        # · n).
        inverse = self.inverse[:, None] * np.einsum("pmi,pi->pm", rays, normals)
        inverse /= np.einsum("pi,pi->p", u, normals)[:, None]
        uv = np.empty((*rays.shape[:2], 2))
        for i, lens in enumerate(self.cameras):
            mine = camera == i
            points = rays[mine] - inverse[mine][..., None] * bundle.t[i]
            uv[mine] = lens.project(points @ bundle.R[i])[0]
        return uv

    def _sample(self, camera: NDArray[np.int64], uv: Floats, layer: int = 0) -> NDArray[np.float32]:
        """Return gray values (P, 169), or slopes, where cameras (P,) have pixels uv."""
        values = np.zeros(uv.shape[:2], np.float32)
        for (frame, i), layers in self.layers.items():
            mine = (self.frame == frame) & (camera == i)
            if mine.any():
                at = uv[mine].astype(np.float32)
                how: Any = None, cv2.INTER_LANCZOS4, None, cv2.BORDER_REPLICATE
                values[mine] = cv2.remap(layers[layer], at, *how)
        return values

    def _correlation(self, a: NDArray[np.float32], b: NDArray[np.float32]) -> Floats:
        """Return the zero-mean normalised cross-correlation of patches, (P,)."""

        def normalised(patch: NDArray[np.float32]) -> Floats:
            patch = patch - (patch * self.window).sum(axis=1, keepdims=True)
            return patch / np.sqrt((patch**2 * self.window).sum(axis=1, keepdims=True) + 1e-3)

        return np.asarray((normalised(a) * normalised(b) * self.window).sum(axis=1), np.float64)


def _with_slopes(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
    """Return an image in gray, a little blurred, and its slopes to the right and down."""
    smooth = cv2.GaussianBlur(in_gray(image).astype(np.float32), (0, 0), 0.8)
    slopes = [cv2.Sobel(smooth, -1, *order, ksize=3) / 8 for order in ((1, 0), (0, 1))]
    return np.asarray(smooth, np.float32), *(np.asarray(slope, np.float32) for slope in slopes)
