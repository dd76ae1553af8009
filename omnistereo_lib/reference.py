"""Start here: the whole method in one file, from fisheye images to depth (paper, Sections III, IV).

This is the definition, in plain torch, for any device and precision. The code in `stereo` is faster
and gives the same numbers, which the tests check against this file; on a device that has no fast
code, this file runs.

H × W rays of the panorama, N spheres, images of (h, w) pixels. NaN: unknown, since no camera, or no
pair, sees it.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, pad

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.rig import Pair, Rig
from omnistereo_lib.geometry.sphere import SphereGrid

# images have variance 1; patches below this hold only the rounding of the interpolation
FLAT_VARIANCE = 1e-6
MAX_LAPS = 64  # of a path around the panorama; images take two or three

# ---- Geometry: Section III-A ----


def rays(width: int, height: int, phi_deg: tuple[float, float]) -> Tensor:
    """ρ(θ, φ) = (cos φ sin θ, sin φ, cos φ cos θ): unit vectors of the pixels, (H, W, 3)."""
    # θ goes once around, φ from the first elevation to the last, both at the centres of pixels.
    theta = (torch.arange(width, dtype=torch.float64) + 0.5) * (2 * math.pi / width) - math.pi
    first, last = math.radians(phi_deg[0]), math.radians(phi_deg[1])
    phi = first + (torch.arange(height, dtype=torch.float64) + 0.5) * ((last - first) / height)
    phi, theta = torch.meshgrid(phi, theta, indexing="ij")
    # x points right, y down and z forward. The paper prints ρ with x and z exchanged.
    return torch.stack([phi.cos() * theta.sin(), phi.sin(), phi.cos() * theta.cos()], -1)


def project(points: Tensor, camera: OcamCamera) -> Tensor:
    """A(Π(X; Φ)): pixels (..., 2) of points X (..., 3) in the camera's frame, NaN where unseen."""
    x, y, z = points.unbind(-1)
    side = torch.hypot(x, y)
    # t is the angle below the plane of the lens: −π/2 on the optical axis, above 0 behind the lens.
    t = torch.atan2(-z, side)
    max_t = math.radians(camera.max_fov_deg / 2) - math.pi / 2
    # The inverse polynomial is the distance from the centre: r(t) = b₀ + b₁ t + b₂ t² + …
    r = torch.zeros_like(t)
    for b in reversed(camera.inv_poly.tolist()):
        r = r * t.clamp(max=max_t) + b
    # Go as far in the direction of the point, then apply A, the affine map from lens to sensor.
    r = torch.where(side > 0, r / side, 0.0)
    (c, d, e), (u0, v0), (width, height) = camera.affine, camera.center, camera.image_size
    u, v = r * (x + e * y) + u0, r * (d * x + c * y) + v0
    # It sees what is in its field of view, inside the image up to rounding, and on its mask.
    inside = (u >= -1e-6) & (u <= width - 1 + 1e-6) & (v >= -1e-6) & (v <= height - 1 + 1e-6)
    seen = inside & (t <= max_t + 1e-12)
    if camera.mask is not None:
        row, column = v.where(seen, 0.0).round().long(), u.where(seen, 0.0).round().long()
        seen = seen & torch.tensor(camera.mask, device=points.device)[row, column]
    return torch.stack([u, v], -1).where(seen[..., None], torch.nan)


# ---- The sphere sweep: Section III-B, Eq. 1 ----


def sample(maps: Tensor, pixels: Tensor) -> Tensor:
    """I(x): maps (C, h, w) read between their pixels, at x (..., 2): (C, ...), NaN where x is."""
    # grid_sample counts from −1, the centre of the first pixel, to 1, the centre of the last.
    last = pixels.new_tensor([maps.shape[2] - 1.0, maps.shape[1] - 1.0])
    at = (2 * pixels.nan_to_num() / last - 1).to(maps.dtype).reshape(1, 1, -1, 2)
    values = grid_sample(maps[None], at, padding_mode="border", align_corners=True)[0, :, 0]
    return values.unflatten(1, pixels.shape[:-1]).where(~pixels[..., 0].isnan(), torch.nan)


def warp(
    image: Tensor, camera: OcamCamera, T_rig_cam: Pose, rays: Tensor, inverse_depth: Tensor
) -> Tensor:
    """S(p) = I(Π(M(Θ*) ρ(p)/d)) of an image (h, w), d one or for each ray: (H, W), Eq. 1."""
    # Sphere 0 is at infinity. Points times d stay finite there, and Π needs only their direction.
    T_cam_rig = T_rig_cam.inverse()
    R, t = rays.new_tensor(T_cam_rig.R), rays.new_tensor(T_cam_rig.t)
    points = rays @ R.T + inverse_depth.clamp(min=2.0**-23)[..., None] * t
    return sample(image[None], project(points, camera))[0]


# ---- The cost volume: Section III-B, Eq. 2 ----


def zncc(a: Tensor, b: Tensor, window: int) -> Tensor:
    """F(a, b) = (1 − cov(a, b) / √(var a · var b)) / 2 of patches around pixels of (B, H, W)."""

    def mean(x: Tensor) -> Tensor:
        # A patch continues across the ±180° seam and ends at the first and the last row.
        r = window // 2
        return avg_pool2d(pad(x[None], (r, r, 0, 0), mode="circular"), window, 1, (r, 0))[0]

    # A patch has the pixels that both cameras see: n is their fraction of the window.
    seen = ~(a.isnan() | b.isnan())
    a, b, n = a.where(seen, 0.0), b.where(seen, 0.0), mean(seen.to(a.dtype)).clamp(min=1e-12)
    mean_a, mean_b = mean(a) / n, mean(b) / n
    var_a, var_b = mean(a * a) / n - mean_a**2, mean(b * b) / n - mean_b**2
    covariance = mean(a * b) / n - mean_a * mean_b
    # A patch without texture is neither a match nor a mismatch.
    textured = (var_a > FLAT_VARIANCE) & (var_b > FLAT_VARIANCE)
    correlation = torch.where(textured, covariance / (var_a * var_b).clamp(min=1e-30).sqrt(), 0.0)
    return ((1 - correlation.clamp(-1, 1)) / 2).where(seen, torch.nan)


def mean_over_pairs(costs: Tensor) -> Tensor:
    """C = mean_ij F(S_i, S_j) of costs (pairs, ...), over the pairs that see the ray, Eq. 2."""
    return costs.nanmean(0)


def cost_volume(
    images: Sequence[Tensor],
    rig: Rig,
    rays: Tensor,
    inverse_depths: Tensor,
    pairs: Sequence[Pair],
    window: int,
) -> Tensor:
    """C(p, n), the cost of every ray on every sphere: (H, W, N), in [0, 1], 0 = match, Eq. 2."""
    spheres, cameras = [], [*zip(images, rig.cameras, rig.T_rig_cam, strict=True)]
    # All cameras on one sphere, then each pair: a point matches on the sphere of its depth.
    for d in inverse_depths:
        views = [warp(*camera, rays, d) for camera in cameras]
        costs = torch.stack([zncc(views[i][None], views[j][None], window)[0] for i, j in pairs])
        spheres.append(mean_over_pairs(costs))
    return torch.stack(spheres, -1)


def correlate(features: Sequence[Tensor], pixels: Sequence[Tensor], groups: int) -> Tensor:
    """mean_{i≠j} f_i f_j of features (C, h, w) at pixels (..., 2), by group: (groups + 1, ...)."""
    total, squares, k = (torch.zeros((), device=features[0].device) for _ in range(3))
    for maps, uv in zip(features, pixels, strict=True):
        seen = ~uv[..., 0].isnan()
        f = sample(maps, uv).where(seen, 0.0)
        total, squares, k = total + f, squares + f.square(), k + seen
    # All k (k − 1) pairs at once, for any number of cameras: Σ_{i≠j} f_i f_j = (Σ f)² − Σ f².
    products = (total.square() - squares) / (k * (k - 1)).clamp(min=1)
    # The last channel tells a network how many cameras see the cell, as k / 4.
    return torch.cat([products.unflatten(0, (groups, -1)).mean(1), k[None] / 4])


# ---- Semi-global matching: Section III-B (Hirschmüller 2008) ----


def message(path: Tensor, p1: float, p2: float) -> Tensor:
    """M(n) = min(L(n), L(n ± 1) + P1, min L + P2) − min L: told to the next pixel (..., N)."""
    lowest = path.amin(-1, keepdim=True)
    # One step to a neighbouring sphere costs P1. Beyond the first and the last there is none.
    around = pad(path, (1, 1), value=math.inf)
    step = torch.minimum(around[..., :-2], around[..., 2:]) + p1
    # A jump from the best sphere to any other costs P2. Without − min L the sums would grow.
    return torch.minimum(torch.minimum(path, step), lowest + p2) - lowest


def fill_unknown(volume: Tensor) -> Tensor:
    """C(p, n), the mean cost of the ray where it is unknown, which prefers no sphere: (H, W, N)."""
    return torch.where(volume.isnan(), volume.nanmean(-1, keepdim=True).nan_to_num(0.0), volume)


def along_the_rows(cost: Tensor, p1: float, p2: float, leftward: bool, wrap: bool) -> Tensor:
    """L_r = C + M of the path r = → or ←, around the seam: (H, W, N)."""
    H, W, N = cost.shape
    # All rows at once. A ring has no first column: the path goes around in laps, the first from
    # M = 0, each other from the last message of the lap before, until a lap changes nothing.
    path, told = torch.empty_like(cost), cost.new_zeros(H, N)
    for _ in range(MAX_LAPS if wrap else 1):
        before = told
        for x in reversed(range(W)) if leftward else range(W):
            path[:, x] = cost[:, x] + told
            told = message(path[:, x], p1, p2)
        if torch.equal(told, before):
            break
    return path


def across_the_rows(
    cost: Tensor, p1: float, p2: float, upward: bool, wrap: bool, diagonals: bool
) -> Tensor:
    """Σ_r L_r of the paths r = ↓ ↘ ↙, or ↑ ↗ ↖: (H, W, N)."""
    H, W, N = cost.shape
    # All columns of a row at once, on three paths, which start with M = 0 in the first row.
    total, told = torch.empty_like(cost), cost.new_zeros(3 if diagonals else 1, W, N)
    for y in reversed(range(H)) if upward else range(H):
        paths = cost[y] + told
        total[y] = paths.sum(0)
        told = message(paths, p1, p2)
        # A diagonal arrives one column further; across the seam it goes on if there is one.
        for k, shift, edge in ((1, 1, 0), (2, -1, W - 1)) if diagonals else ():
            told[k] = told[k].roll(shift, 0)
            told[k, edge] *= wrap
    return total


def sgm(volume: Tensor, p1: float, p2: float, paths: int = 8, wrap: bool = True) -> Tensor:
    """S(p, n) = Σ_r L_r(p, n) over 4 or 8 paths r: (H, W, N), NaN where C is."""
    cost, total = fill_unknown(volume), torch.zeros_like(volume)
    for backward in (False, True):
        total += along_the_rows(cost, p1, p2, backward, wrap)
        total += across_the_rows(cost, p1, p2, backward, wrap, paths == 8)
    return total.masked_fill_(volume.isnan(), torch.nan)


# ---- From a volume to depth: Section III-B ----


def winner(volume: Tensor, subindex: bool) -> Tensor:
    """n* = argmin_n C(p, n), or the vertex of the parabola through it: (H, W)."""
    cost = torch.where(volume.isnan(), torch.inf, volume)
    n, last = cost.argmin(-1), cost.shape[-1] - 1
    left, best, right = (
        cost.gather(-1, k.clamp(0, last)[..., None])[..., 0] for k in (n - 1, n, n + 1)
    )
    # At either end, and next to an unknown cell, there is no parabola: the answer is n* itself.
    bend = left - 2 * best + right
    inner = (n > 0) & (n < last) & (bend > 0) & bend.isfinite() & subindex
    index = torch.where(inner, n + (left - right) / (2 * bend), n.to(cost.dtype))
    return index.where(best.isfinite(), torch.nan)


def confidence(volume: Tensor) -> Tensor:
    """1 − C(n*)/C(n₂), n₂ the best sphere that is not n* or beside it: (H, W), in [0, 1]."""
    cost = torch.where(volume.isnan(), torch.inf, volume)
    best, n = cost.min(-1)
    # A neighbour of the best sphere is nearly as good on any surface: it says nothing about rivals.
    beside = torch.stack([n - 1, n, n + 1], -1).clamp(0, cost.shape[-1] - 1)
    second = cost.scatter(-1, beside, torch.inf).amin(-1)
    return torch.where(second > 0, 1 - best / second, 0.0).where(best.isfinite(), torch.nan)


def local_mean(volume: Tensor, cells: int) -> tuple[Tensor, Tensor]:
    """Σ p n / Σ p and Σ p of p = 1 − C, within one of `cells` of the best sphere: (H, W) each."""
    N = int(volume.shape[-1])  # a number while ONNX traces, too
    radius = max(1.0, N / cells)
    around = torch.arange(-math.ceil(radius) - 1, math.ceil(radius) + 2, device=volume.device)
    # At an edge the mean over all spheres would lie between two surfaces. One around the best
    # sphere alone would jump from cell to cell and make steps of a wall, so two more are taken,
    # each around the one before (mean shift).
    index = total = volume.argmin(-1).float()
    for _ in range(3):
        near = index.round().long()[..., None] + around
        inside = (near >= 0) & (near < N)
        # A sphere fills n ± ½, and counts as far as it lies in the window.
        share = (radius + 1 - (near - index[..., None]).abs()).clamp(0, 1)
        mass = (1 - volume.gather(-1, near.clamp(0, N - 1))) * share * inside
        total = mass.sum(-1)
        index = (mass * near).sum(-1) / total
    return index, total


# ---- The whole method: Fig. 4 ----


def estimate(
    images: Sequence[Tensor],
    rig: Rig,
    grid: SphereGrid,
    pairs: Sequence[Pair],
    window: int,
    p1: float,
    p2: float,
) -> Tensor:
    """n*(p), the sphere of every ray: (H, W), from one normalised gray image (h, w) per camera."""
    # The sweep is centred at the mean of the camera centres, its spheres are even in 1 / depth.
    rig, ends = rig.recentered(), (1 / grid.max_depth, 1 / grid.min_depth)
    spheres = torch.linspace(*ends, grid.num_spheres, dtype=torch.float64)
    directions = rays(grid.width, grid.height, grid.phi_deg)
    volume = cost_volume(images, rig, directions, spheres, pairs, window)
    # Raw costs of single rays are noisy: each ray listens to its neighbours on eight paths.
    return winner(sgm(volume, p1, p2), subindex=True)
