"""Solutions of notebook 10: rendering a city."""

import numpy as np

# --- 10 Render a city -------------------------------------------------------------------------------------


def my_distance(z_depth, ray):
    # Stretch the ray until its z is the depth; what is asked is its length then.
    stretched = ray * z_depth / ray[2]
    return np.linalg.norm(stretched)


def my_share(mask, low_deg, high_deg):
    rows = len(mask)
    height = (high_deg - low_deg) / rows  # of one row
    elevation = np.radians(low_deg + (np.arange(rows) + 0.5) * height)  # the rows' middles
    weight = np.cos(elevation)  # a circle of latitude is that much shorter than the equator
    return np.sum(weight * mask.mean(axis=1)) / np.sum(weight)


def my_seen_by(rays, axes, fov_deg):
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    cosine = rays @ axes.T  # (H, W, cameras)
    return np.sum(cosine >= np.cos(np.radians(fov_deg / 2)), axis=-1)


def my_edges(index, jump):
    right = np.abs(np.roll(index, -1, axis=1) - index) > jump  # the last column's neighbour is the first; NaN is False
    below = np.abs(index[1:] - index[:-1]) > jump
    edge = right | np.roll(right, 1, axis=1)  # both sides of a jump
    edge[:-1] |= below
    edge[1:] |= below
    return edge.astype(int)
