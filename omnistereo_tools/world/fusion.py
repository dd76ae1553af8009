"""Depth of many frames in one volume: truncated signed distances (Curless and Levoy 1996), and
depth read back.

Voxels lie in blocks of 8 × 8 × 8, and only blocks near a surface that some frame has seen are kept.
A voxel holds the weighted mean of its signed distances to the surfaces that the frames see on its
ray, taken for planes: positive in front, at most a band of 4 voxels. A frame that sees through a
voxel counts as much as one that sees a surface there: it carves what is wrong. Our own, since the
libraries that fuse depth take pinhole images or points, not the rays of a panorama.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.geometry.pose import Floats, Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.kernels.compiled import compiled
from omnistereo_lib.stereo.threads import map_threads

# Voxels a side; the block of voxel i is i >> 3, its place there i & 7.
BLOCK = 8
# In voxels: farther from a surface, distances are cut off.
BAND = 4.0
# In voxels: the band along a ray where the surface is seen flat.
_ALONG = 8.0
# A voxel of less weight is not believed.
LEAST_WEIGHT = 0.02
# In 1/m, in place of infinity.
_FARTHEST = np.float32(1e-3)
# In metres: where a ray of `march` begins.
_NEAREST = 1.0
# Blocks that a thread takes at a time.
_PART = 512
# Standard deviations of a depth: in metres, and in spheres.
_DEPTH_SD, _SPHERES_SD = 0.03, 0.6
# A surface is clearly beyond a voxel by so many standard deviations of its depth, and so much of
# the voxel's distance. On the drive (16 frames, 320 x 80, VolumeNet) a third fewer vertices of cars
# stay, and as much of what stands is found within 20 cm; without the second, half, but 1 % less.
_CLEAR_SD, _CLEAR = 3.0, 0.5
# Neighbouring depths with a larger ratio have an edge between them.
_ONE_SURFACE = 1.2
# Bits of each coordinate of a block in its key.
_BITS = 21
_Array = NDArray[Any]
_loop = compiled(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@dataclass(frozen=True, eq=False)
class View:
    """What one frame knows of the world."""

    T_world_rig: Pose
    inverse_depth: NDArray[np.float32]  #: (H, W), 1/m, more than 0
    weight: NDArray[np.float32]  #: (H, W); 0: the ray is left out
    color: NDArray[np.float32]  #: (H, W, channels)

    @classmethod
    def of(
        cls, pose: Pose, inverse_depth: _Array, confidence: _Array, color: _Array, sphere: float
    ) -> View:
        """Return a view whose weights are confidence over variance.

        Args:
            inverse_depth, confidence: (H, W); rays without depth, NaN, are left out.
            color: (H, W) or (H, W, channels).
            sphere: Difference of the inverse depths of two spheres, 1/m.
        """
        inverse = np.maximum(np.nan_to_num(inverse_depth), _FARTHEST).astype(np.float32)
        # A depth z = 1/q that is off by some spheres, dq, is off by dz = dq / q²: far depths are
        # uncertain.
        variance = _DEPTH_SD**2 + (_SPHERES_SD * sphere / inverse**2) ** 2
        weight = np.where(np.isnan(inverse_depth), 0, np.nan_to_num(confidence) / variance)
        pixels = np.nan_to_num(color).reshape(*inverse.shape, -1)
        return cls(pose, inverse, weight.astype(np.float32), pixels.astype(np.float32))


# What compiled code works on; a class of our own would be in Numba's cache, and break it when it is
# renamed. blocks (B, 3): voxel (i, j, k) of block b lies at (8 b + (i, j, k)) · voxel directory:
# number of each block in a box around all of them, or -1 first (3,): the block at the corner of the
# box distance in metres and weight (B, 8, 8, 8), color (B, 8, 8, 8, channels)
_Single = NDArray[np.float32]
Voxels = tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], _Single, _Single, _Single]
# Inverse depth, weight, cosine and colour of a view; columns per radian, the column of θ = 0; the
# same of rows and φ.
_Panorama = tuple[_Single, _Single, _Single, _Single, float, float, float, float]


def touched_blocks(view: View, grid: SphereGrid, voxel: float, reach: float) -> NDArray[np.int64]:
    """Return the blocks that a view needs, around its surface, as sorted keys for `Volume`."""
    size = BLOCK * voxel
    used = (view.inverse_depth > 1 / reach) & (view.weight > 0)
    if not used.any():
        return np.zeros(0, np.int64)
    directions, depth = grid.rays()[used] @ view.T_world_rig.R.T, 1 / view.inverse_depth[used]
    # A band of the surface is longer along a ray that meets it flat: 1 / cosine times, up to a
    # limit. Steps of half a block at most along it find the blocks; a key packs three coordinates.
    half, keys = np.minimum(BAND / _cosine(view.inverse_depth, grid)[used], _ALONG) * voxel, []
    for share in np.linspace(-1, 1, int(np.ceil(4 * half.max() / size)) + 1):
        blocks = np.floor(
            (view.T_world_rig.t + directions * (depth + share * half)[:, None]) / size
        ).astype(np.int64)
        x, y, z = (blocks + (1 << _BITS - 1)).T
        keys.append(np.unique(x << 2 * _BITS | y << _BITS | z))
    return np.unique(np.concatenate(keys))


def _cosine(inverse: NDArray[np.float32], grid: SphereGrid) -> NDArray[np.float32]:
    """Return the cosine of the angle between each ray and the normal of the surface there, (H, W),
    0.1 to 1.

    On a plane the inverse depth q is linear in the ray: the cosine is q / √(q² + |∇q|²), ∇ on the
    sphere.
    """
    per_theta, _, per_phi, _ = _mapping(grid)
    # cos φ of each row: columns are so much closer together there.
    level = np.linalg.norm(grid.rays()[:, :1, ::2], axis=-1)  # cos φ
    down = np.pad(np.diff(inverse, axis=0), ((1, 1), (0, 0)), "edge") * per_phi
    right = np.diff(inverse, axis=1, append=inverse[:, :1]) * per_theta / level
    # Of the slopes to both sides the smaller one: the other may lie across an edge.
    square = np.minimum(down[:-1] ** 2, down[1:] ** 2) + np.minimum(
        right**2, np.roll(right, 1, axis=1) ** 2
    )
    return np.maximum(inverse / np.sqrt(inverse**2 + square), 0.1).astype(np.float32)


def bytes_needed(keys: NDArray[np.int64], channels: int) -> int:
    """Return the memory that a volume of the blocks `keys` takes, and its surface.

    The directory has room for the box around all blocks. Of each voxel the surface needs two
    numbers more.
    """
    first, last = (_blocks_of(keys).min(axis=0), _blocks_of(keys).max(axis=0))
    box = math.prod((last - first + 1).tolist())
    return 4 * (box + len(keys) * BLOCK**3 * (4 + channels))


def _blocks_of(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the blocks (B, 3) of keys."""
    mask = (1 << _BITS) - 1
    blocks = np.stack([keys >> 2 * _BITS, keys >> _BITS & mask, keys & mask], axis=1)
    return blocks - (1 << _BITS - 1)


class Volume:
    """Signed distances over blocks of voxels.

    Args:
        keys: Of `touched_blocks` of all views, each once.
        voxel: Side of a voxel in metres.
        reach: Metres from the rig beyond which nothing is fused.
        channels: Of the colours.
    """

    def __init__(self, keys: NDArray[np.int64], voxel: float, reach: float, channels: int) -> None:
        self.voxel, self.reach, blocks = voxel, reach, _blocks_of(keys)
        first = blocks.min(axis=0)
        directory = np.full(blocks.max(axis=0) - first + 1, -1, np.int32)
        directory[tuple((blocks - first).T)] = np.arange(len(blocks), dtype=np.int32)
        shape = (len(blocks), BLOCK, BLOCK, BLOCK)
        distance, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        color = np.zeros((*shape, channels), np.float32)
        self.voxels: Voxels = blocks, directory, first, distance, weight, color

    def integrate(self, view: View, grid: SphereGrid) -> None:
        """Add a view, or with negative weights take it out again."""
        T = view.T_world_rig
        near = self._reached(view, grid)
        cosine = _cosine(view.inverse_depth, grid)
        panorama = view.inverse_depth, view.weight, cosine, view.color, *_mapping(grid)

        def add(start: int) -> None:
            part, doubt = near[start : start + _PART], _SPHERES_SD * grid.step
            _integrate(self.voxels, panorama, T.R, T.t, part, self.voxel, self.reach, doubt)

        list(map_threads(add, range(0, len(near), _PART)))

    def _reached(self, view: View, grid: SphereGrid) -> NDArray[np.int64]:
        """Return the blocks that can get anything from a view: not those behind all it sees."""
        T, size, (per_theta, _, per_phi, _) = view.T_world_rig, BLOCK * self.voxel, _mapping(grid)
        seen = ((self.voxels[0] + 0.5) * size - T.t) @ T.R
        away, radius = np.linalg.norm(seen, axis=1), np.sqrt(0.75) * size
        # So many pixels around that of its middle show a block, at most; a few count for rounding.
        level = np.hypot(seen[:, 0], seen[:, 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = max(per_theta, per_phi) * np.arcsin(radius / level) + 2
        # How far rays see, the farthest within 1, 2, 4 … pixels of each.
        far = np.where(view.weight == 0, 0, 1 / view.inverse_depth + _ALONG * self.voxel)
        far, steps = far.astype(np.float32), np.ceil(np.log2(pixels))
        reached = np.isnan(steps)
        for step in range(int(np.log2(grid.width / 4))):
            r = max(1, 1 << step >> 1)
            far = cv2.dilate(np.pad(far, ((0, 0), (r, r)), "wrap"), np.ones((2 * r + 1,) * 2))
            far = far[:, r:-r]
            some = np.flatnonzero(steps == step)
            reached[some] = grid.look_up(far, seen[some])[0] > away[some] - radius
        reached |= steps >= int(np.log2(grid.width / 4))
        return np.flatnonzero(reached & (away < self.reach + size))

    def march(self, T_world_rig: Pose, rays: Floats, farthest: float) -> tuple[_Single, _Single]:
        """Return inverse depth and colour of the first surface along rays (H, W, 3) of the rig.

        Args:
            farthest: Metres; rays that meet nothing up to there are NaN.

        Returns:
            inverse_depth: float32, (H, W)
            color: float32, (H, W, channels)
        """
        directions, t = rays @ T_world_rig.R.T, T_world_rig.t
        inverse = np.full(rays.shape[:2], np.nan, np.float32)
        color = np.full((*rays.shape[:2], self.voxels[-1].shape[-1]), np.nan, np.float32)

        def render(row: int) -> None:
            _march(self.voxels, directions[row], t, self.voxel, farthest, inverse[row], color[row])

        list(map_threads(render, range(len(rays))))
        return inverse, color


def _mapping(grid: SphereGrid) -> tuple[float, float, float, float]:
    """Return columns per radian, the column of θ = 0, rows per radian and the row of φ = 0."""
    # Columns are linear in θ and rows in φ, so two points tell both mappings.
    (column, row), (other, lower) = grid.project([[0.0, 0.0, 1.0], [0.5, 0.25, 1.0]])[0].tolist()
    return (
        (other - column) / np.arctan2(0.5, 1.0),
        column,
        (lower - row) / np.arctan2(0.25, np.hypot(0.5, 1.0)),
        row,
    )


@_loop
def _integrate(
    voxels: Voxels,
    panorama: _Panorama,
    R: Floats,
    t: Floats,
    part: NDArray[np.int64],
    voxel: float,
    reach: float,
    doubt: float,
) -> None:
    blocks, _, _, distances, weights, colors = voxels
    inverse, confidence, cosine, pixels, per_theta, column0, per_phi, row0 = panorama
    (height, width), band = inverse.shape, BAND * voxel
    for number in part:
        x0, y0, z0 = blocks[number] * BLOCK
        for i in range(BLOCK):
            for j in range(BLOCK):
                for k in range(BLOCK):
                    # The voxel in the axes of the rig, Rᵀ (x - t), and the pixel of its ray.
                    x, y, z = (
                        (x0 + i) * voxel - t[0],
                        (y0 + j) * voxel - t[1],
                        (z0 + k) * voxel - t[2],
                    )
                    right = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
                    down = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
                    ahead = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
                    level = np.sqrt(right * right + ahead * ahead)
                    away = np.sqrt(level * level + down * down)
                    row = row0 + per_phi * np.arctan2(down, level)
                    # Beyond the first and last row, with some room for rounding at the poles, the
                    # panorama has no pixel.
                    if away > reach or row < -0.501 or row > height - 0.499:
                        continue
                    column = column0 + per_theta * np.arctan2(right, ahead)
                    pixel = min(max(int(np.rint(row)), 0), height - 1), int(np.rint(column)) % width
                    w = confidence[pixel]
                    # The distance to the surface along the ray; times the cosine, to its plane.
                    along = 1 / _interpolate(inverse, row, column, inverse[pixel]) - away
                    s = along * cosine[pixel]
                    # Unknown, or hidden behind the surface.
                    if w == 0 or s < -band or along < -_ALONG * voxel:
                        continue
                    # Far beyond, an uncertain surface still leaves no doubt that the voxel is free:
                    # it counts as one that is seen there, so that what has driven on is carved.
                    far, clear = along + away, _CLEAR_SD * doubt * (along + away) ** 2
                    if s >= band and along > max(clear, _CLEAR * away):
                        w *= (_DEPTH_SD**2 + (doubt * far**2) ** 2) / (
                            _DEPTH_SD**2 + (doubt * away**2) ** 2
                        )
                    at = number, i, j, k
                    total = weights[at] + w
                    # A view is taken out, and no other frame has seen the voxel.
                    if w < 0 and total < LEAST_WEIGHT:
                        weights[at] = 0
                        continue
                    # The running weighted mean (Curless and Levoy 1996): D ← D + w (d - D) / (W +
                    # w). The distance is cut off at the band, and colours are taken within it only.
                    weights[at] = total
                    share = w / total
                    distances[at] += share * (min(s, band) - distances[at])
                    if s < band:
                        for n in range(colors.shape[-1]):
                            colors[at][n] += share * (pixels[pixel][n] - colors[at][n])


@_loop
def _interpolate(inverse: NDArray[np.float32], row: float, column: float, nearest: float) -> float:
    """Interpolate inverse depth, unless the four pixels show more than one surface."""
    height, width = inverse.shape
    # Bilinear between four pixels: around the seam in columns, not beyond the first and the last
    # row.
    i, j = int(np.floor(row)), int(np.floor(column))
    if i < 0 or i + 1 >= height:
        return nearest
    left, right = j % width, (j + 1) % width
    a, b, c, d = inverse[i, left], inverse[i, right], inverse[i + 1, left], inverse[i + 1, right]
    if max(a, b, c, d) > _ONE_SURFACE * min(a, b, c, d):
        return nearest
    u, v = column - j, row - i
    return (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)


@_loop
def find_block(voxels: Voxels, i: int, j: int, k: int) -> int:
    """Return the number of the block of a voxel, or -1."""
    directory, first = voxels[1], voxels[2]
    a, b, c = (i >> 3) - first[0], (j >> 3) - first[1], (k >> 3) - first[2]
    height, width, depth = directory.shape
    inside = min(a, b, c) >= 0 and a < height and b < width and c < depth
    return directory[a, b, c] if inside else -1


@_loop
def distance_at(voxels: Voxels, i: int, j: int, k: int) -> float:
    """Return the distance of a voxel; infinite if no frame has seen it."""
    number = find_block(voxels, i, j, k)
    return _in_block(voxels, number, i, j, k) if number >= 0 else np.inf


@_loop
def _in_block(voxels: Voxels, number: int, i: int, j: int, k: int) -> float:
    at = number, i & 7, j & 7, k & 7
    return voxels[3][at] if voxels[4][at] > LEAST_WEIGHT else np.inf


@_loop
def _sample(voxels: Voxels, number: int, x: float, y: float, z: float) -> float:
    """Return the distance at a point in voxels, in a block, trilinear; infinite beside an unseen
    voxel.
    """
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w, total = x - i, y - j, z - k, 0.0
    inside = max(i & 7, j & 7, k & 7) < 7
    for a in range(2):
        for b in range(2):
            for c in range(2):
                if inside:
                    value = _in_block(voxels, number, i + a, j + b, k + c)
                else:
                    value = distance_at(voxels, i + a, j + b, k + c)
                if value == np.inf:
                    return np.inf
                total += value * (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
    return total


@_loop
def _way_out(x: float, direction: float, shortest: float) -> float:
    """Return the way in voxels to where a ray leaves its block, at most `shortest`."""
    if direction == 0:
        return shortest
    start = np.floor(x / BLOCK) * BLOCK
    return min(shortest, (start + BLOCK - x if direction > 0 else start - x) / direction)


@_loop
def _march(
    voxels: Voxels,
    directions: Floats,
    t: Floats,
    voxel: float,
    farthest: float,
    inverse: _Single,
    color: _Single,
) -> None:
    for ray in range(len(directions)):
        d, s, before, s_before = directions[ray], _NEAREST, np.inf, 0.0
        while s < farthest:
            x, y, z = (
                (t[0] + s * d[0]) / voxel,
                (t[1] + s * d[1]) / voxel,
                (t[2] + s * d[2]) / voxel,
            )
            # There is nothing in an empty block: jump to where the ray leaves it, and a little on.
            number = find_block(voxels, int(np.floor(x)), int(np.floor(y)), int(np.floor(z)))
            if number < 0:
                s += voxel * (
                    _way_out(x, d[0], _way_out(y, d[1], _way_out(z, d[2], 2.0 * BLOCK))) + 0.01
                )
                before = np.inf
                continue
            value = _sample(voxels, number, x, y, z)
            # From positive to negative the ray goes through the surface from its front: by linear
            # interpolation
            #     s = s₀ + (s₁ - s₀) d₀ / (d₀ - d₁)
            if value <= 0 and 0 < before < np.inf:
                inverse[ray] = 1 / (s_before + (s - s_before) * before / (before - value))
                i, j, k = int(np.rint(x)), int(np.rint(y)), int(np.rint(z))
                color[ray] = voxels[5][find_block(voxels, i, j, k), i & 7, j & 7, k & 7]
                break
            # The distance says about how far the nearest surface is: go 0.6 of it, and half a voxel
            # at least.
            before, s_before = value, s
            s += 0.5 * voxel if value == np.inf else max(0.5 * voxel, 0.6 * value)
