"""Surface nets (Gibson 1998): the surface of a volume, a vertex in each cell it crosses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.kernels.compiled import compiled
from omnistereo_tools.world.fusion import BAND, BLOCK, Volume, Voxels, distance_at, find_block

_LEAST_WEIGHT = 2.0  # 1/m²: only a surface that is known to 0.7 m is drawn
_LEAST_TRIANGLES = 100  # of a piece: smaller ones are noise
_SAME = 0.12  # of a distance: a frame sees a surface that is no farther from its depth
_loop = compiled(nogil=True, error_model="numpy")
_Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles in the axes of the world, counter-clockwise as seen by the rig."""

    vertices: NDArray[np.float32]  #: (V, 3), metres
    faces: NDArray[np.int64]  #: (F, 3)
    color: NDArray[np.float32]  #: (V, channels)


def extract_surface(volume: Volume) -> Surface:
    """Return the surface where distances change sign, without pieces of few triangles."""
    weight = np.where(volume.voxels[4] < _LEAST_WEIGHT, np.float32(0), volume.voxels[4])
    voxels = (*volume.voxels[:4], weight, volume.voxels[5])
    numbers = np.full(voxels[3].shape, -1, np.int32)
    none = np.zeros((0, 3), np.float32)
    count = _place_vertices(voxels, volume.voxel, numbers, none, none)
    vertices = np.zeros((count, 3), np.float32)
    color = np.zeros((count, voxels[5].shape[-1]), np.float32)
    _place_vertices(voxels, volume.voxel, numbers, vertices, color)
    count = _join(voxels, volume.voxel, numbers, np.zeros((0, 3), np.int64))
    faces = np.zeros((count, 3), np.int64)
    _join(voxels, volume.voxel, numbers, faces)
    return _without_small_pieces(Surface(vertices, faces, color))


def seen_surface(
    surface: Surface, views: Iterable[tuple[Pose, NDArray[np.float32]]], grid: SphereGrid
) -> Surface:
    """Return what frames see of a surface, without pieces of few triangles.

    Between what is free in front of an edge and what is hidden behind it, distances change sign
    where no frame has seen anything. Arguments as of `choose_views`. On the drive and on 5 frames
    of the training drive (320 x 80, VolumeNet) 57 and 3 % of what is over 1 m from the truth goes;
    82 and 68 % of the truth still have a surface within 30 cm, .8 and .1 less.
    """
    (middle, normals), unseen = _places(surface), np.arange(len(surface.faces))
    for view in views:
        none = np.zeros(len(unseen), np.float32)
        seen, _ = _seen_larger(middle[unseen], normals[unseen], none, view, grid)
        unseen = np.delete(unseen, seen)
    return _without_small_pieces(replace(surface, faces=np.delete(surface.faces, unseen, axis=0)))


def choose_views(
    surface: Surface, views: Iterable[tuple[Pose, NDArray[np.float32]]], grid: SphereGrid
) -> NDArray[np.int64]:
    """Return for each triangle the view that shows it largest, -1 where none sees it.

    Args:
        views: Rig → world, and the inverse depth (H, W), 1/m, of the fused frame.
    """
    middle, normals = _places(surface)
    best, chosen = np.zeros(len(middle), np.float32), np.full(len(middle), -1)
    for k, view in enumerate(views):
        seen, size = _seen_larger(middle, normals, best, view, grid)
        chosen[seen], best[seen] = k, size
    return chosen


def _places(surface: Surface) -> tuple[_Single, _Single]:
    """Return the middle and the normal of each triangle, (F, 3)."""
    corners = surface.vertices[surface.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return corners.mean(axis=1), normals


def _seen_larger(
    middle: _Single, normals: _Single, least: _Single, view: tuple[Pose, _Single], grid: SphereGrid
) -> tuple[NDArray[np.int64], _Single]:
    """Return the triangles that a frame sees larger than `least`, and how large."""
    pose, inverse_depth = view
    away = middle - pose.t.astype(np.float32)
    distance = np.sqrt(np.einsum("ki,ki->k", away, away))
    size = -np.einsum("ki,ki->k", away, normals) / distance**3
    larger = np.flatnonzero(size > least)
    inverse, inside = grid.look_up(inverse_depth, away[larger] @ pose.R)
    # Nothing is before it: a panorama that ends there shows it.
    seen = larger[inside & (np.abs(inverse * distance[larger] - 1) < _SAME)]
    return seen, size[seen]


def _without_small_pieces(surface: Surface) -> Surface:
    faces, count = surface.faces, len(surface.vertices)
    ends = np.tile(faces[:, 0], 2), faces[:, 1:].T.ravel()
    graph = coo_matrix((np.ones(2 * len(faces), bool), ends), (count, count))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    faces = faces[np.bincount(piece)[piece] >= _LEAST_TRIANGLES] if len(faces) else faces
    used = np.zeros(count, bool)
    used[faces] = True
    return Surface(surface.vertices[used], (np.cumsum(used) - 1)[faces], surface.color[used])


@_loop
def _crossed(a: float, b: float, voxel: float) -> bool:
    """Return whether a surface lies between two neighbours; a larger jump is from free space to
    behind a surface.
    """
    return (a > 0) != (b > 0) and abs(a - b) < BAND * voxel


@_loop
def _place_vertices(
    voxels: Voxels, voxel: float, numbers: NDArray[np.int32], vertices: _Single, color: _Single
) -> int:
    """Number the cells that the surface crosses, each by its first voxel; fill the mean of its
    crossings, if given.
    """
    count, corners = 0, np.zeros(8)
    for number in range(len(voxels[0])):
        first = voxels[0][number] * BLOCK
        for cell in range(BLOCK**3):
            i, j, k = cell >> 6, cell >> 3 & 7, cell & 7
            # Which cells are crossed is known when they are filled.
            if len(vertices) > 0 and numbers[number, i, j, k] < 0:
                continue
            for n in range(8):
                a, b, c = i + (n >> 2), j + (n >> 1 & 1), k + (n & 1)
                corners[n] = distance_at(voxels, first[0] + a, first[1] + b, first[2] + c)
            if corners.min() > 0 or corners.max() <= 0:
                continue
            x, y, z, crossings, behind = 0.0, 0.0, 0.0, 0, 0
            for n in range(8):
                for axis in range(3):
                    other = n | 4 >> axis
                    if other != n and _crossed(corners[n], corners[other], voxel):
                        on_edge = corners[n] / (corners[n] - corners[other])
                        x += on_edge if axis == 0 else n >> 2
                        y += on_edge if axis == 1 else n >> 1 & 1
                        z += on_edge if axis == 2 else n & 1
                        crossings += 1
                        behind = n if corners[n] <= 0 else other
            if crossings == 0:
                continue
            numbers[number, i, j, k] = count
            if len(vertices) > 0:
                i, j, k = first[0] + i, first[1] + j, first[2] + k
                vertices[count, 0] = (i + x / crossings) * voxel
                vertices[count, 1] = (j + y / crossings) * voxel
                vertices[count, 2] = (k + z / crossings) * voxel
                i, j, k = i + (behind >> 2), j + (behind >> 1 & 1), k + (behind & 1)
                color[count] = voxels[5][find_block(voxels, i, j, k), i & 7, j & 7, k & 7]
            count += 1
    return count


@_loop
def _join(
    voxels: Voxels, voxel: float, numbers: NDArray[np.int32], faces: NDArray[np.int64]
) -> int:
    """Join the vertices around each edge that the surface crosses; fill `faces` if it has room."""
    count = 0
    for number in range(len(voxels[0])):
        x, y, z = voxels[0][number] * BLOCK
        for cell in range(BLOCK**3):
            if numbers[number, cell >> 6, cell >> 3 & 7, cell & 7] < 0:
                continue
            at = (x + (cell >> 6), y + (cell >> 3 & 7), z + (cell & 7))
            here = distance_at(voxels, at[0], at[1], at[2])
            if here == np.inf:
                continue
            for axis in range(3):
                along = distance_at(
                    voxels, at[0] + (axis == 0), at[1] + (axis == 1), at[2] + (axis == 2)
                )
                if not _crossed(here, along, voxel):
                    continue
                one, other = (axis + 1) % 3, (axis + 2) % 3
                a = _vertex(voxels, numbers, at, -1, -1)
                b = _vertex(voxels, numbers, at, one, -1)
                c = _vertex(voxels, numbers, at, one, other)
                d = _vertex(voxels, numbers, at, -1, other)
                if min(a, b, c, d) < 0:
                    continue
                if len(faces) > 0:
                    if here > 0:  # the free side is where the edge begins
                        b, d = d, b
                    faces[count, 0], faces[count, 1], faces[count, 2] = a, b, c
                    faces[count + 1, 0], faces[count + 1, 1], faces[count + 1, 2] = a, c, d
                count += 2
    return count


@_loop
def _vertex(
    voxels: Voxels, numbers: NDArray[np.int32], at: tuple[int, int, int], one: int, other: int
) -> int:
    """Return the vertex of a voxel's cell, or of the one before it along one axis or two, or -1."""
    i, j, k = at[0] - (0 in (one, other)), at[1] - (1 in (one, other)), at[2] - (2 in (one, other))
    number = find_block(voxels, i, j, k)
    return -1 if number < 0 else numbers[number, i & 7, j & 7, k & 7]
