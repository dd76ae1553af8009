"""The exercises' checkers against students: right ones, each usual mistake, and garbage."""

import math
import sys
from fractions import Fraction
from itertools import combinations, pairwise
from statistics import fmean

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from course import exercises
from course.exercises import diagnose
from omnistereo_lib import index_error

CHECKERS = [value for name, value in vars(exercises).items() if name.startswith("check_")]


# Students who need more than a line.


def list_of_ray(theta, phi, depth):
    return [depth * math.cos(phi) * math.sin(theta), depth * math.sin(phi), depth * math.cos(phi) * math.cos(theta)]


def ray_by_rotations(theta, phi, depth):
    """Forward, turned down by φ, then to the right by θ."""
    return Rotation.from_euler("xy", [-phi, theta]).apply([0, 0, depth])


def pixel_by_matrix(camera, T_rig_cam, point):
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = T_rig_cam.R, T_rig_cam.t
    uv, _ = camera.project((np.linalg.inv(M) @ [*point, 1])[:3])
    return tuple(uv)


def pixel_in_place(camera, T_rig_cam, point):
    point -= T_rig_cam.t
    return camera.project(T_rig_cam.R.T @ point)[0].astype(np.float32)


def zncc_loops(a, b):
    a, b = a.ravel().tolist(), b.ravel().tolist()
    products = squares_a = squares_b = 0.0
    for x, y in zip(a, b, strict=True):
        products += (x - fmean(a)) * (y - fmean(b))
        squares_a += (x - fmean(a)) ** 2
        squares_b += (y - fmean(b)) ** 2
    return (1 - products / math.sqrt(squares_a * squares_b)) / 2


def zncc_normalised(a, b):
    a, b = ((x - x.mean()) / x.std() for x in (a.astype(np.float32), b.astype(np.float32)))
    return 0.5 - 0.5 * (a * b).mean()


def zncc_half_centred(a, b):
    return (1 - np.mean(a * b) / (a.std() * b.std())) / 2


def mean_loops(costs):
    means = []
    for ray in costs.T:
        seen = [cost for cost in ray if not math.isnan(cost)]
        means.append(sum(seen) / len(seen))
    return means


def mean_by_counting(costs):
    seen = np.isfinite(costs)
    costs[~seen] = 0
    return costs.sum(0) / seen.sum(0)


def mean_of_complete_pairs(costs):
    return costs[~np.isnan(costs).any(axis=1)].mean(axis=0)


def sgm_loops(cost, before, p1, p2, first=1, subtract=True, low=None):
    """One step; `first` is the first sphere with a left neighbour, and Python's before[-1] is the last."""
    low = min(before) if low is None else low
    result = []
    for n in range(len(cost)):
        ways = [before[n], low + p2]
        if n >= first:
            ways.append(before[n - 1] + p1)
        if n + 1 < len(before):
            ways.append(before[n + 1] + p1)
        result.append(cost[n] + min(ways) - subtract * low)
    return result


def sgm_transitions(cost, before, p1, p2):
    n = np.arange(len(cost))
    penalty = np.choose(np.minimum(abs(n[:, None] - n), 2), [0, p1, p2])
    return (cost + (before + penalty).min(1) - before.min()).astype(np.float32)


def sgm_in_place(cost, before, p1, p2):
    before -= before.min()
    padded = np.pad(before, 1, mode="edge")  # the end's own cost plus P1 is never the cheapest
    cost += np.min([before, padded[:-2] + p1, padded[2:] + p1, np.full_like(before, p2)], axis=0)
    return cost


def sgm_rolled(cost, before, p1, p2):
    around = np.minimum(np.roll(before, 1), np.roll(before, -1)) + p1
    return cost + np.minimum(np.minimum(before, around), before.min() + p2) - before.min()


def sgm_jump_from_nowhere(cost, before, p1, p2):
    padded = np.pad(before, 1, constant_values=1e9)
    return cost + np.min([before, padded[:-2] + p1, padded[2:] + p1, 0 * before + p2], axis=0) - before.min()


def sgm_no_jump(cost, before, p1, p2):
    padded = np.pad(before, 1, constant_values=1e9)
    return cost + np.min([before, padded[:-2] + p1, padded[2:] + p1], axis=0) - before.min()


def vertex_of_fit(left, middle, right):
    a, b, _ = np.polyfit([-1, 0, 1], [left, middle, right], 2)
    return np.float32(-b / (2 * a))


def vertex_of_fit_from_left(left, middle, right):
    a, b, _ = np.polyfit([0, 1, 2], [left, middle, right], 2)
    return -b / (2 * a)


def vertex_half_a(left, middle, right):
    a, b = left - 2 * middle + right, (right - left) / 2
    return -b / (2 * a)


def mae_loops(index, truth, N):
    errors = [100 / N * abs(i - t) for i, t in zip(index, truth, strict=True) if i == i]
    return sum(errors) / len(errors)


def library_mae(index, truth, N):
    return index_error(index, truth, N)["MAE"]


# What each checker says ("right", or words of its hint) to which student.


def polynomial(poly, r):
    return sum(a * r**k for k, a in enumerate(poly))


def ray_loops(u, v, poly, center):
    x, y = u - center[0], v - center[1]
    z = -polynomial(poly, math.hypot(x, y))
    length = math.sqrt(x * x + y * y + z * z)
    return [x / length, y / length, z / length]


def ray_like(change):
    """The right ray of changed arguments."""
    return lambda u, v, poly, center: ray_loops(*change(u, v, poly, center))


RAY_OF_PIXEL = [
    ("right", ray_loops),
    ("right", lambda u, v, poly, c: np.float32(ray_loops(u, v, poly, c))),
    ("f is negative before the lens", lambda *a: np.array(ray_loops(*a)) * [1, 1, -1]),
    ("a ray is a unit vector", lambda u, v, p, c: [u - c[0], v - c[1], -polynomial(p, math.hypot(u - c[0], v - c[1]))]),
    ("count from the centre", ray_like(lambda u, v, poly, c: (u, v, poly, [0, 0]))),
    ("not the centre minus the pixel", lambda *a: np.array(ray_loops(*a)) * [-1, -1, 1]),
    ("its parts are swapped", ray_like(lambda u, v, poly, c: (u, v, poly, c[::-1]))),
    ("x belongs to u", lambda *a: np.array(ray_loops(*a))[[1, 0, 2]]),
    ("the highest first", ray_like(lambda u, v, poly, c: (u, v, poly[::-1], c))),
    ("not its first coefficient alone", ray_like(lambda u, v, poly, c: (u, v, poly[:1], c))),
]

ANGLE_FROM_AXIS = [
    ("right", lambda ray: math.degrees(math.acos(ray[2] / np.linalg.norm(ray)))),
    ("right", lambda ray: np.rad2deg(np.arctan2(np.linalg.norm(ray[:2]), ray[2]))),
    ("degrees are asked", lambda ray: math.atan2(math.hypot(*ray[:2]), ray[2])),
    ("loses the quadrant", lambda ray: math.degrees(math.atan(math.hypot(*ray[:2]) / ray[2]))),
    ("above the xy-plane", lambda ray: math.degrees(math.atan2(ray[2], math.hypot(*ray[:2])))),
    ("below the xy-plane", lambda ray: math.degrees(math.atan2(-ray[2], math.hypot(*ray[:2])))),
    ("wants a unit vector", lambda ray: math.degrees(math.acos(ray[2]))),
    ("leaves y out", lambda ray: math.degrees(math.atan2(ray[0], ray[2]))),
    ("60° from 120°", lambda ray: math.degrees(math.asin(math.hypot(*ray[:2]) / np.linalg.norm(ray)))),
]

RMS_PER_COMPONENT = [
    ("right", lambda e: math.sqrt(fmean(x * x for x in e.ravel().tolist()))),
    ("right", lambda e: np.linalg.norm(e) / math.sqrt(e.size)),
    ("rms distance", lambda e: math.sqrt(fmean(u * u + v * v for u, v in e.tolist()))),
    ("mean distance", lambda e: fmean(math.hypot(u, v) for u, v in e.tolist())),
    ("take the root", lambda e: fmean(x * x for x in e.ravel().tolist())),
    ("mean magnitude", lambda e: fmean(abs(x) for x in e.ravel().tolist())),
    ("a bias is an error", lambda e: np.sqrt(np.var(e))),
    ("not their sum", lambda e: np.linalg.norm(e)),
]

RELATIVE_POSE = [
    ("right", lambda a, b: b @ a.inverse()),
    ("right", lambda a, b: (a @ b.inverse()).inverse().as_vector()),
    ("the way back", lambda a, b: a @ b.inverse()),
    ("stands on the left", lambda a, b: a.inverse() @ b),
    ("belongs to camera 1's pose", lambda a, b: b.inverse() @ a),
    ("do not meet", lambda a, b: b @ a),
    ("do not meet", lambda a, b: a @ b),
]

COUNT_UNKNOWNS = [
    ("right", lambda C, K, M: C * (4 + M) + 6 * (C - 1) + 6 * K),
    ("right", lambda C, K, M: np.int64(C * M + 10 * C + 6 * K - 6)),
    ("no unknown", lambda C, K, M: C * (4 + M) + 6 * C + 6 * K),
    ("each capture's board", lambda C, K, M: C * (4 + M) + 6 * (C - 1)),
    ("ties the cameras together", lambda C, K, M: C * (4 + M) + 6 * (C - 1) + 6 * K * C),
    ("a1 is zero", lambda C, K, M: C * (5 + M) + 6 * (C - 1) + 6 * K),
    ("there is no a1", lambda C, K, M: C * (6 + M) + 6 * (C - 1) + 6 * K),
    ("adjusted with the poses", lambda C, K, M: 6 * (C - 1) + 6 * K),
    ("a lens of its own", lambda C, K, M: 4 + M + 6 * (C - 1) + 6 * K),
    ("six numbers", lambda C, K, M: C * (4 + M) + 3 * (C - 1) + 3 * K),
]

DEPTH_ERROR = [
    ("right", lambda depth, N, nearest: depth * depth / nearest / (N - 1)),
    ("right", lambda depth, N, nearest: np.float32(depth**2 / (nearest * (N - 1)))),
    ("enters squared", lambda depth, N, nearest: depth / (nearest * (N - 1))),
    ("one step in inverse depth", lambda depth, N, nearest: 1 / nearest / (N - 1)),
    ("not N", lambda depth, N, nearest: depth**2 / (nearest * N)),
    ("not in depth", lambda depth, N, nearest: nearest / (N - 1)),
    ("sphere 1", lambda depth, N, nearest: nearest * (N - 1)),
    ("further out", lambda depth, N, nearest: 1 / (1 / depth - 1 / (nearest * (N - 1))) - depth),
    ("sphere nearer", lambda depth, N, nearest: depth - 1 / (1 / depth + 1 / (nearest * (N - 1)))),
]

INDEX_TO_DEPTH = [
    ("right", lambda n, N, nearest: 1 / (n / (nearest * (N - 1)))),
    ("right", lambda n, N, nearest: math.inf if n == 0 else nearest * (N - 1) / n),
    ("right", lambda n, N, nearest: 1 / np.linspace(0, 1 / nearest, N, dtype=np.float32)[n]),
    ("inverse depth in 1/m", lambda n, N, nearest: n / nearest / (N - 1)),
    ("N - 1 steps", lambda n, N, nearest: nearest / (n / N)),
    ("n, not n + 1", lambda n, N, nearest: nearest * N / (n + 1)),
    ("turn n around", lambda n, N, nearest: 1 / np.linspace(1 / nearest, 0, N)[n]),
    ("even in inverse depth", lambda n, N, nearest: np.linspace(0, nearest, N)[n]),
    ("metres are asked", lambda n, N, nearest: (N - 1) / n),
]
POINT_OF_RAY = [
    ("right", list_of_ray),
    ("right", ray_by_rotations),
    ("right", lambda t, p, d: d * np.float32([np.cos(p) * np.sin(t), np.sin(p), np.cos(p) * np.cos(t)])),
    ("in radians already, and", lambda t, p, d: list_of_ray(np.deg2rad(t), np.deg2rad(p), d)),
    ("NumPy wants radians, and", lambda t, p, d: list_of_ray(math.degrees(t), math.degrees(p), d)),
    ("swapped", lambda t, p, d: list_of_ray(p, t, d)),
    ("printed ρ", lambda t, p, d: d * np.array([np.cos(p) * np.cos(t), np.sin(p), np.cos(p) * np.sin(t)])),
    ("y points down", lambda t, p, d: list_of_ray(t, -p, d)),
    ("x points right", lambda t, p, d: list_of_ray(-t, p, d)),
    ("a ray has length 1", lambda t, p, d: np.array([np.sin(t), np.sin(p), np.cos(t)]) * d),
    ("not along z", lambda t, p, d: [d * np.tan(t), d * np.tan(p) / np.cos(t), d]),
    ("`depth` metres along it", lambda t, p, d: list_of_ray(t, p, 1)),
    ("divided by the depth", lambda t, p, d: list_of_ray(t, p, 1 / d)),
    ("centimetres", lambda t, p, d: list_of_ray(t, p, 100 * d)),
]
PIXEL_OF_POINT = [
    ("right", lambda camera, T, p: camera.project(T.inverse() @ p)[0]),
    ("right", pixel_by_matrix),
    ("right", pixel_in_place),
    ("invert it", lambda camera, T, p: camera.project(T @ p)[0]),
    ("not transposed", lambda camera, T, p: camera.project(T.R.dot(p - T.t))[0]),
    ("not -t", lambda camera, T, p: camera.project(T.R.T.dot(p) - T.t)[0]),
    ("not t:", lambda camera, T, p: camera.project(p @ T.R + T.t)[0]),
    ("translation is left out", lambda camera, T, p: camera.project(p @ T.R)[0]),
    ("rotation is left out", lambda camera, T, p: camera.project(p - T.t)[0]),
    ("transform it first", lambda camera, T, p: camera.project(p)[0]),
    ("yours are swapped", lambda camera, T, p: pixel_by_matrix(camera, T, p)[::-1]),
    ("add no half pixel", lambda camera, T, p: [x + 0.5 for x in pixel_by_matrix(camera, T, p)]),
    ("subtract no half pixel", lambda camera, T, p: [x - 0.5 for x in pixel_by_matrix(camera, T, p)]),
    ("do not round", lambda camera, T, p: [round(x) for x in pixel_by_matrix(camera, T, p)]),
    ("do not cut off", lambda camera, T, p: [int(x) for x in pixel_by_matrix(camera, T, p)]),
    ("return it alone", lambda camera, T, p: camera.project(T.inverse() @ p)),
]
ROTATION_ERROR = [
    ("right", lambda degrees, width: degrees / (360 / width)),
    ("right", lambda degrees, width: np.radians(np.float32(degrees)) * width / (2 * np.pi)),
    ("not 2π", lambda degrees, width: width * degrees / (2 * np.pi)),
    ("not 180°", lambda degrees, width: np.radians(degrees) / np.pi * width),
    ("not W - 1", lambda degrees, width: (width - 1) * degrees / 360),
    ("multiply by the error", lambda degrees, width: width / 360),
    ("pixels are asked", lambda degrees, width: 360 / width),
    ("swapped", lambda degrees, width: 360 / width * degrees),
    ("other sign", lambda degrees, width: -degrees * width / 360),
]
ZNCC_COST = [
    ("right", zncc_loops),
    ("right", zncc_normalised),
    ("right", lambda a, b: (1 - np.corrcoef(a.ravel(), b.ravel())[0, 1]) / 2),
    ("ZNCC itself", lambda a, b: np.corrcoef(a.flat, b.flat)[0, 1]),
    ("a match must cost 0", lambda a, b: (1 + np.corrcoef(a.flat, b.flat)[0, 1]) / 2),
    ("runs from 0 to 2", lambda a, b: 1 - np.corrcoef(a.flat, b.flat)[0, 1]),
    ("brackets", lambda a, b: 1 - np.corrcoef(a.flat, b.flat)[0, 1] / 2),
    ("each patch's mean first", lambda a, b: (1 - np.vdot(a, b) / np.linalg.norm(a) / np.linalg.norm(b)) / 2),
    ("in the product, too", zncc_half_centred),
    ("by both standard deviations", lambda a, b: (1 - np.cov(a.flat, b.flat, ddof=0)[0, 1]) / 2),
    ("not by the variances", lambda a, b: (1 - np.cov(a.flat, b.flat, ddof=0)[0, 1] / (a.var() * b.var())) / 2),
    ("the deviations by n:", lambda a, b: (1 - np.cov(a.flat, b.flat)[0, 1] / (a.std() * b.std())) / 2),
    (
        "the deviations by n - 1",
        lambda a, b: (1 - np.mean((a - a.mean()) * (b - b.mean())) / (a.std(ddof=1) * b.std(ddof=1))) / 2,
    ),
    ("sum and mean", lambda a, b: (1 - np.sum((a - a.mean()) * (b - b.mean())) / (a.std() * b.std())) / 2),
    ("shape (18, 18)", lambda a, b: (1 - np.corrcoef(a, b)) / 2),
]
MEAN_OVER_PAIRS = [
    ("right", mean_loops),
    ("right", mean_by_counting),
    ("right", lambda costs: np.nanmean(costs.astype(np.float32), axis=0)),
    ("leave the NaN out", lambda costs: np.mean(costs, axis=0)),
    ("no 0", lambda costs: np.where(np.isnan(costs), 0, costs).mean(axis=0)),
    ("no 0", lambda costs: np.nansum(costs, axis=0) / costs.shape[0]),
    ("that is the sum", lambda costs: np.nan_to_num(costs).sum(axis=0)),
    ("not everywhere", mean_of_complete_pairs),
    ("mean over the rays", lambda costs: np.nanmean(costs, axis=1)),
    ("pairs and rays", lambda costs: costs[~np.isnan(costs)].mean()),
    ("best pair", lambda costs: np.nan_to_num(costs, nan=1).min(axis=0)),
    ("median", lambda costs: [np.median(ray[~np.isnan(ray)]) for ray in costs.T]),
]
PIXELS_PER_INDEX = [
    ("right", lambda b, nearest, N, width: b / nearest / (N - 1) / (2 * np.pi / width)),
    ("right", lambda b, nearest, N, width: math.degrees(math.atan(b / (nearest * (N - 1)))) * width / 360),
    (
        "right",
        lambda b, nearest, N, width: np.float32(b) * np.diff(np.linspace(0, 1 / nearest, N))[0] * width / math.tau,
    ),
    ("angle in radians:", lambda b, nearest, N, width: b / nearest / (N - 1)),
    ("angle in degrees", lambda b, nearest, N, width: math.degrees(b / nearest / (N - 1))),
    ("not 360", lambda b, nearest, N, width: b / nearest / (N - 1) / (360 / width)),
    ("not π", lambda b, nearest, N, width: b / nearest / (N - 1) / (np.pi / width)),
    ("N - 1 steps", lambda b, nearest, N, width: b / nearest / N / (2 * np.pi / width)),
    ("whole range", lambda b, nearest, N, width: b / nearest / (2 * np.pi / width)),
    ("inverse depth", lambda b, nearest, N, width: b * np.diff(np.linspace(0, nearest, N))[0] * width / math.tau),
    ("spheres in a pixel", lambda b, nearest, N, width: math.tau / width / b * nearest * (N - 1)),
]
SGM_STEP = [
    ("right", sgm_loops),
    ("right", sgm_transitions),
    ("right", sgm_in_place),
    ("subtract min_k", lambda cost, before, p1, p2: sgm_loops(cost, before, p1, p2, subtract=False)),
    ("P1 is for", lambda cost, before, p1, p2: sgm_in_place(cost, before, p2, p1)),
    ("does not wrap", sgm_rolled),
    ("does not wrap", lambda cost, before, p1, p2: sgm_loops(cost, before, p1, p2, first=0)),
    ("a jump starts at", sgm_jump_from_nowhere),
    ("the jump is missing", sgm_no_jump),
    (
        "neighbours are missing",
        lambda cost, before, p1, p2: cost + np.minimum(before, before.min() + p2) - before.min(),
    ),
    ("not over this ray's", lambda cost, before, p1, p2: sgm_loops(cost, before, p1, p2, low=cost.min())),
    ("own cost", lambda cost, before, p1, p2: sgm_transitions(0 * cost, before, p1, p2)),
    ("cost alone", lambda cost, before, p1, p2: cost),
]
PARABOLA = [
    ("right", lambda left, middle, right: (left - right) / (2 * (left - 2 * middle + right))),
    ("right", vertex_of_fit),
    ("the sign", lambda left, middle, right: (right - left) / (2 * (left - 2 * middle + right))),
    ("below the line is missing", lambda left, middle, right: (left - right) / (left - 2 * middle + right)),
    ("brackets", lambda left, middle, right: (left - right) / 2 * (left - 2 * middle + right)),
    ("leading coefficient", vertex_half_a),
    ("counts twice", lambda left, middle, right: 0.5 * (left - right) / (left - middle + right)),
    ("from the left sample", vertex_of_fit_from_left),
]
INDEX_ERROR = [
    ("right", mae_loops),
    ("right", lambda index, truth, N: 100 / N * np.nanmean(np.abs(index - truth))),
    ("right", lambda index, truth, N: np.nanmean(np.abs(np.float32(truth) - np.float32(index)) * 100 / N)),
    ("that is in indices", lambda index, truth, N: np.nanmean(abs(index - truth))),
    ("that is a fraction", lambda index, truth, N: np.nanmean(abs(index - truth)) / N),
    ("not by N - 1", lambda index, truth, N: np.nanmean(abs(index - truth)) / (N - 1) * 100),
    ("do not round", lambda index, truth, N: mae_loops(index, np.round(truth), N)),
    ("spoils the mean", lambda index, truth, N: 100 / N * np.mean(np.abs(index - truth))),
    ("among those to divide by", lambda index, truth, N: 100 / N * np.nansum(np.abs(index - truth)) / len(index)),
    ("counts them as 100", library_mae),
    ("that is the sum", lambda index, truth, N: np.nansum(np.abs(index - truth)) * 100 / N),
    ("root mean square", lambda index, truth, N: 100 / N * np.nanmean((index - truth) ** 2) ** 0.5),
    ("absolute value of each", lambda index, truth, N: 100 / N * np.nanmean(index - truth)),
    ("absolute value of each", lambda index, truth, N: 100 / N * abs(np.nanmean(index - truth))),
    ("of each ray: take", lambda index, truth, N: 100 / N * np.abs(index - truth)[~np.isnan(index)]),
    ("of each ray: leave", lambda index, truth, N: 100 / N * np.abs(index - truth)),
]


def cosine(a, b):
    return sum(x * y for x, y in zip(a.tolist(), b.tolist(), strict=True)) / math.sqrt(
        sum(x * x for x in a.tolist()) * sum(y * y for y in b.tolist())
    )


COSINE_COST = [
    ("right", lambda a, b: (1 - cosine(a, b)) / 2),
    ("right", lambda a, b: np.sum((a / np.linalg.norm(a) - b / np.linalg.norm(b)) ** 2) / 4),
    ("that is the cosine", cosine),
    ("the sign", lambda a, b: (1 + cosine(a, b)) / 2),
    ("divide by 2", lambda a, b: 1 - cosine(a, b)),
    ("by both lengths", lambda a, b: (1 - np.vdot(a, b)) / 2),
    ("the second length, too", lambda a, b: (1 - a @ b / np.sqrt(a @ a)) / 2),
    ("the first length, too", lambda a, b: (1 - a @ b / np.sqrt(b @ b)) / 2),
    ("not by their squares", lambda a, b: (1 - a @ b / (a @ a * (b @ b))) / 2),
    ("as ZNCC does", zncc_loops),
    ("the angle by π", lambda a, b: math.acos(cosine(a, b)) / math.pi),
]


def hinge(change):
    """The mean over rays of what `change` makes of (match, non-match, margin)."""
    return lambda positive, negative, m: fmean(
        change(p, n, m) for p, n in zip(positive.tolist(), negative.tolist(), strict=True)
    )


HINGE_LOSS = [
    ("right", hinge(lambda p, n, m: max(0.0, m + n - p))),
    ("right", lambda p, n, m: torch.nn.MarginRankingLoss(m)(*map(torch.tensor, (p, n)), torch.ones(len(p))).numpy()),
    ("the roles", hinge(lambda p, n, m: max(0.0, m + p - n))),
    ("costs 0, not less", hinge(lambda p, n, m: m + n - p)),
    ("of each ray: take the maximum", lambda *a: max(0.0, hinge(lambda p, n, m: m + n - p)(*a))),
    ("margin is missing", hinge(lambda p, n, m: max(0.0, n - p))),
    ("margin is added", hinge(lambda p, n, m: max(0.0, n - p - m))),
    ("that is the sum", lambda p, n, m: np.clip(m + n - p, 0, None).sum()),
    ("loss of each ray", lambda p, n, m: np.clip(m + n - p, 0, None)),
    ("not squared", hinge(lambda p, n, m: max(0.0, m + n - p) ** 2)),
    ("cost nothing count", lambda p, n, m: fmean(x for x in (m + n - p).tolist() if x > 0)),
]


def patch_by_probing(layers, kernel):
    """How much smaller an image gets, and one."""
    size = 50
    for _ in range(layers):
        size = len(np.convolve(np.ones(size), np.ones(kernel), "valid"))
    return 50 - size + 1


PATCH_SIZE = [
    ("right", patch_by_probing),
    ("right", lambda layers, kernel: layers * kernel - layers + 1),
    ("overlap", lambda layers, kernel: layers * kernel),
    ("add it", lambda layers, kernel: layers * (kernel - 1)),
    ("to both sides", lambda layers, kernel: 1 + layers * (kernel - 1) // 2),
    ("not one", lambda layers, kernel: kernel + (layers - 1)),
    ("sizes add up", lambda layers, kernel: kernel**layers),
    ("one layer sees", lambda layers, kernel: kernel),
]
SPHERE_LABELS = [
    ("right", lambda gt, n: (np.abs(gt - n) > 0.5).astype(int)),
    ("right", lambda gt, n: [[0 if round(x) == n else 1 for x in row] for row in gt.tolist()]),
    ("turned around", lambda gt, n: (np.abs(gt - n) < 0.5) * 1.0),
    ("rounding down", lambda gt, n: (gt.astype(int) != n) * 1),
    ("not up", lambda gt, n: [[float(math.ceil(x) != n) for x in row] for row in gt]),
    ("no whole number", lambda gt, n: (gt != n) * 1),
    ("half a sphere", lambda gt, n: 1 - np.isclose(gt, n, rtol=0, atol=1)),
    ("yes or no", lambda gt, n: abs(gt - n)),
    ("not of the first row", lambda gt, n: [0 if round(x) == n else 1 for x in gt[0].tolist()]),
]


def entropy(cost, label, weights=(0.5, 0.5), log=math.log, turn=False):
    """The cross-entropy by adding up; weights of all positives and of all negatives."""
    means = []
    for kind in (0, 1):
        chosen = [c for c, x in zip(cost.tolist(), label.tolist(), strict=True) if x == kind]
        means.append(fmean(-log(c if (kind == 1) != turn else 1 - c) for c in chosen))
    return weights[0] * means[0] + weights[1] * means[1]


def torch_entropy(cost, label, balanced=True):
    weight = torch.tensor(np.where(label == 0, 0.5 / np.mean(label == 0), 0.5 / np.mean(label == 1)))
    loss = torch.nn.functional.binary_cross_entropy(
        torch.tensor(cost), torch.tensor(label), weight if balanced else None
    )
    return float(loss)


BALANCED_LOSS = [
    ("right", entropy),
    ("right", torch_entropy),
    ("there are more negatives", lambda cost, label: torch_entropy(cost, label, balanced=False)),
    ("divide the sum of both means by 2", lambda cost, label: entropy(cost, label, (1, 1))),
    ("the minus", lambda cost, label: -entropy(cost, label)),
    ("probability of *no*", lambda cost, label: entropy(cost, label, turn=True)),
    ("base 2", lambda cost, label: entropy(cost, label, log=math.log2)),
    ("base 10", lambda cost, label: entropy(cost, label, log=math.log10)),
    (
        "squared error",
        lambda cost, label: fmean([np.mean((cost - label)[label == kind] ** 2) for kind in (0, 1)]),
    ),
    ("positives are missing", lambda cost, label: entropy(cost, label, (0, 0.5))),
    ("negatives are missing", lambda cost, label: entropy(cost, label, (0.5, 0))),
]


def field_backwards(layers):
    """From the output back to the input: one pixel, then what each layer needs of the one before."""
    size = 1
    for kernel, stride in reversed(layers):
        size = (size - 1) * stride + kernel
    return size


def field(layers, own=False, compound=True, one=1):
    """From the input on, with the usual mistakes."""
    size, jump = one, 1
    for kernel, stride in layers:
        if own:
            jump = jump * stride if compound else stride
        size += (kernel - 1) * jump
        if not own:
            jump *= stride
    return size


RECEPTIVE_FIELD = [
    ("right", field_backwards),
    ("right", field),
    ("two pixels of the input", lambda layers: field([(kernel, 1) for kernel, _ in layers])),
    ("not for itself", lambda layers: field(layers, own=True)),
    ("strides multiply up", lambda layers: field(layers, own=True, compound=False)),
    (
        "layers behind it only",
        lambda layers: math.prod(s for _, s in layers) * field([(kernel, 1) for kernel, _ in layers]),
    ),
    ("one pixel: add it", lambda layers: field(layers, one=0)),
    ("windows overlap", lambda layers: sum(kernel for kernel, _ in layers)),
]


def share_of(error, limit, wrong):
    """Percent of rays, row by row, that `wrong` says are."""
    judged = [wrong(x, limit) for row in error.tolist() for x in row]
    return 100 * judged.count(True) / len(judged)


SHARE_ABOVE = [
    ("right", lambda error, limit: share_of(error, limit, lambda x, limit: not x <= limit)),
    ("right", lambda error, limit: np.float32(100 - 100 * np.mean(error <= limit))),
    ("a fraction", lambda error, limit: np.mean(~(error <= limit))),
    ("NaN is False", lambda error, limit: share_of(error, limit, lambda x, limit: x > limit)),
    ("not left out", lambda error, limit: 100 * np.mean(error[np.isfinite(error)] > limit)),
    ("still right", lambda error, limit: 100 * np.mean(~(error < limit))),
    ("that are right", lambda error, limit: 100 * np.mean(error <= limit)),
    ("their number", lambda error, limit: int(np.sum(~(error <= limit)))),
    ("of each row", lambda error, limit: 100 * np.mean(~(error <= limit), axis=-1)),
]


def errors_like(rays, sums, squares):
    """Errors e ≥ 0 of all frames together, with these sums: half of a frame's rays on each side of its mean."""
    errors = []
    for n, total, square in zip(rays, sums, squares, strict=True):
        mean = total / n
        spread = math.sqrt(square / n - mean**2)
        errors += [mean - spread] * int(n / 2) + [mean + spread] * int(n / 2)
    return np.array(errors)


POOLED_RMS = [
    ("right", lambda rays, sums, squares: math.sqrt(fmean(errors_like(rays, sums, squares) ** 2))),
    ("right", lambda rays, sums, squares: np.sqrt(np.average(squares / rays, weights=rays))),
    ("take the root", lambda rays, sums, squares: sum(squares) / sum(rays)),
    ("counts too much", lambda rays, sums, squares: fmean(np.sqrt(squares / rays))),
    ("add up first", lambda rays, sums, squares: math.sqrt(fmean(squares / rays))),
    ("divide by the number", lambda rays, sums, squares: math.sqrt(sum(squares))),
    ("under the root", lambda rays, sums, squares: math.sqrt(sum(squares)) / sum(rays)),
    ("each frame's", lambda rays, sums, squares: (squares / rays) ** 0.5),
    ("the mean error", lambda rays, sums, squares: fmean(errors_like(rays, sums, squares))),
    ("standard deviation", lambda rays, sums, squares: np.std(errors_like(rays, sums, squares))),
]


def standard_error_loops(a, b, n_of=lambda n: n - 1, last=math.sqrt):
    differences = [x - y for x, y in zip(a.tolist(), b.tolist(), strict=True)]
    squares = sum((d - fmean(differences)) ** 2 for d in differences)
    return math.sqrt(squares / n_of(len(differences))) / last(len(differences))


STANDARD_ERROR = [
    ("right", standard_error_loops),
    ("right", lambda a, b: np.sqrt(np.cov(a - b) / len(a))),
    ("spread of single frames: the mean", lambda a, b: standard_error_loops(a, b, last=lambda n: 1)),
    ("not by n", lambda a, b: standard_error_loops(a, b, last=lambda n: n)),
    ("its square", lambda a, b: np.cov(a - b) / len(a)),
    ("n - 1 in the variance", lambda a, b: standard_error_loops(a, b, n_of=lambda n: n)),
    ("with n in place", lambda a, b: (a - b).std()),
    ("then look at the spread", lambda a, b: math.sqrt(sum(np.cov(x) for x in (a, b)) / len(a))),
    ("frame by frame first", lambda a, b: np.hypot(a.std(), b.std()) / len(a) ** 0.5),
    ("of a alone", lambda a, b: standard_error_loops(a, 0 * b)),
    ("the mean difference", lambda a, b: a.mean() - b.mean()),
    ("one number is asked", lambda a, b: a - b),
]


def metres_per_unit_loops(positions, i, j, measured):
    return measured / math.dist(positions[i].tolist(), positions[j].tolist())


METRES_PER_UNIT = [
    ("right", metres_per_unit_loops),
    ("right", lambda p, i, j, m: np.float32(m / np.sqrt(np.square(p[i] - p[j]).sum()))),
    ("metres in one unit are asked", lambda *a: 1 / metres_per_unit_loops(*a)),
    ("the measured one divided by it", lambda p, i, j, m: math.dist(p[i], p[j])),
    ("from camera to camera", lambda p, i, j, m: m / math.hypot(*p[j])),
    ("from camera i to camera j", lambda p, i, j, m: m / math.hypot(*p[i])),
    ("adds up the components", lambda p, i, j, m: m / sum(abs(p[i] - p[j]))),
    ("divides by the squared distance", lambda p, i, j, m: m / math.dist(p[i], p[j]) ** 2),
    ("not the largest alone", lambda p, i, j, m: m / max(abs(p[i] - p[j]))),
    ("y is missing", lambda p, i, j, m: m / math.dist(p[i][::2], p[j][::2])),
    ("indices from 0", lambda p, i, j, m: metres_per_unit_loops(p, i - 1, j - 1, m)),
    ("millimetres; return the ratio itself", lambda *a: 10.0 ** round(math.log10(metres_per_unit_loops(*a)))),
]


def pose_from_file(M, t_of=lambda R, t: -R.T @ t, R_of=lambda R: R.T, scale=1e-3, rows=4):
    """The inverse by parts, with one of them wrong."""
    R, t = M[:3, :3].copy(), M[:3, 3].copy()
    M[:3, :3], M[:3, 3] = R_of(R), t_of(R, t) * scale
    return M[:rows]


def pose_by_inverse(M):
    M[:3, 3] /= 1000
    return np.linalg.inv(M)


def pose_wrong(**part):
    return lambda M: pose_from_file(M, **part)


POSE_FROM_FILE = [
    ("right", pose_by_inverse),
    ("right", pose_from_file),
    ("that is the file's matrix", lambda M: M),
    ("still in millimetres", np.linalg.inv),
    ("do not multiply", pose_wrong(scale=1e3)),
    ("the unit is right", pose_wrong(R_of=lambda R: R, t_of=lambda R, t: t)),
    ("only the translation has a unit", lambda M: np.linalg.inv(M) / 1000),
    ("only the translation has a unit", lambda M: np.linalg.inv(M / 1000)),
    ("where the rig's origin was", pose_wrong(t_of=lambda R, t: -t)),
    ("the translation untouched", pose_wrong(t_of=lambda R, t: t)),
    ("the sign", pose_wrong(t_of=lambda R, t: R.T @ t)),
    ("turn it by Rᵀ", pose_wrong(t_of=lambda R, t: -R @ t)),
    ("the rotation must be transposed, too", pose_wrong(R_of=lambda R: R)),
    ("both parts", pose_wrong(R_of=lambda R: R, t_of=lambda R, t: -t)),
    ("no inverse", np.transpose),
    ("the last row", pose_wrong(rows=3)),
]


def spheres_by_counting(baseline, nearest, width, pixels):
    """Add spheres until a step is small enough."""
    N = 2
    while baseline / (nearest * (N - 1)) * width / math.tau > pixels:
        N += 1
    return N


def spheres(turn=math.tau, up=math.ceil, more=1, ratio=lambda b, D: b / D, scale=lambda W: W, per=lambda m, x: m / x):
    """Steps between spheres, with one part wrong."""
    return lambda b, D, W, x: up(per(ratio(b, D) * scale(W) / turn, x)) + more


SPHERES_NEEDED = [
    ("right", spheres_by_counting),
    ("right", spheres(up=np.ceil)),
    ("no part of a sphere", spheres(up=float)),
    ("one too few", spheres(up=math.floor)),
    ("two too few", spheres(up=math.floor, more=0)),
    ("that is the steps", spheres(up=float, more=0)),
    ("for one pixel a sphere", spheres(per=lambda moves, x: moves)),
    ("fewer pixels a sphere need more", spheres(per=lambda moves, x: moves * x)),
    ("full circle, 2π, not π", spheres(turn=math.pi)),
    ("in radians, 2π for W pixels", spheres(turn=360)),
    ("near things move more", spheres(ratio=lambda b, D: b * D)),
    ("not the other way round", spheres(ratio=lambda b, D: D / b)),
    ("counts degrees for pixels", spheres(scale=lambda W: 360)),
    ("counts radians for pixels", spheres(scale=lambda W: math.tau)),
]

DISTANCE_FROM_Z = [
    ("right", lambda z, ray: z / math.cos(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("right", lambda z, ray: np.linalg.norm(np.float32(z) * np.float32(ray / ray[2]))),
    ("turned around", lambda z, ray: z * math.cos(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("divide by its z", lambda z, ray: math.dist(z * ray, (0, 0, 0))),
    ("times the ray's length", lambda z, ray: z / ray[2]),
    ("stretch it", lambda z, ray: math.hypot(ray[0], ray[1], z)),
    ("distance from the axis", lambda z, ray: z * math.tan(math.atan2(math.hypot(*ray[:2]), ray[2]))),
    ("y is missing", lambda z, ray: math.hypot(z * ray[0] / ray[2], z)),
    ("off the axis is longer", lambda z, ray: z),
]


def share_loops(mask, low, high, first=0.5, step=None, cos=math.cos, part=1.0, every=True):
    """The share by adding up pixels; `first` and `step`: where rows lie."""
    covered = total = 0.0
    for k, row in enumerate(mask.tolist()):
        weight = cos(math.radians(low + (k + first) * (high - low) / (step or len(mask))))
        covered += weight * sum(row)
        total += weight * (len(row) if every else 1)
    return part * covered / total


def exact_bands(mask, low, high):
    """The area of each band of rows by Archimedes, which cos of the middle approaches to one common factor."""
    edges = [math.sin(math.radians(low + k * (high - low) / len(mask))) for k in range(len(mask) + 1)]
    areas = [b - a for a, b in pairwise(edges)]
    return sum(area * fmean(row) for area, row in zip(areas, mask.tolist(), strict=True)) / sum(areas)


def share_sum(mask, low, high):
    middles = [low + (k + 0.5) * (high - low) / len(mask) for k in range(len(mask))]
    return sum(math.cos(math.radians(m)) * sum(row) for m, row in zip(middles, mask.tolist(), strict=True))


SHARE_OF_SPHERE = [
    ("right", share_loops),
    ("right", exact_bands),
    ("share of the pixels", lambda mask, low, high: fmean(mask.ravel().tolist())),
    ("in percent", lambda mask, low, high: share_loops(mask, low, high, part=100)),
    ("half a pixel inside", lambda mask, low, high: share_loops(mask, low, high, first=0, step=len(mask) - 1)),
    ("wants radians", lambda mask, low, high: share_loops(mask, low, high, cos=lambda x: math.cos(math.degrees(x)))),
    ("not sin φ", lambda mask, low, high: share_loops(mask, low, high, cos=math.sin)),
    ("by the sum of all weights, not", lambda mask, low, high: share_sum(mask, low, high) / mask.size),
    ("divide by the sum of all of them", lambda mask, low, high: share_sum(mask, low, high)),
    ("once for every pixel", lambda mask, low, high: share_loops(mask, low, high, every=False)),
]


def risk(agree, wrong, group):
    """Share of wrong rays among those that agree, or do not, counted one by one."""
    chosen = [w for a, w in zip(agree.ravel(), wrong.ravel(), strict=True) if a == group]
    return sum(chosen) / len(chosen)


RISK_RATIO = [
    ("right", lambda agree, wrong: risk(agree, wrong, False) / risk(agree, wrong, True)),
    ("right", lambda agree, wrong: (wrong & ~agree).sum() / (~agree).sum() * agree.sum() / (wrong & agree).sum()),
    ("other way round", lambda agree, wrong: risk(agree, wrong, True) / risk(agree, wrong, False)),
    ("shares; divide", lambda agree, wrong: risk(agree, wrong, False) - risk(agree, wrong, True)),
    ("in percent", lambda agree, wrong: 100 * (risk(agree, wrong, False) - risk(agree, wrong, True))),
    ("numbers of rays", lambda agree, wrong: np.sum(wrong & ~agree) / np.sum(wrong & agree)),
    ("not with all", lambda agree, wrong: risk(agree, wrong, False) / np.mean(wrong)),
    ("divide by that", lambda agree, wrong: risk(agree, wrong, False)),
    ("split them by agreement", lambda agree, wrong: risk(wrong, agree, False) / risk(wrong, agree, True)),
]

STUDENTS = {
    exercises.check_index_to_depth: INDEX_TO_DEPTH,
    exercises.check_ray_of_pixel: RAY_OF_PIXEL,
    exercises.check_angle_from_axis: ANGLE_FROM_AXIS,
    exercises.check_rms_per_component: RMS_PER_COMPONENT,
    exercises.check_relative_pose: RELATIVE_POSE,
    exercises.check_count_unknowns: COUNT_UNKNOWNS,
    exercises.check_depth_error: DEPTH_ERROR,
    exercises.check_point_of_ray: POINT_OF_RAY,
    exercises.check_pixel_of_point: PIXEL_OF_POINT,
    exercises.check_rotation_error: ROTATION_ERROR,
    exercises.check_zncc_cost: ZNCC_COST,
    exercises.check_mean_over_pairs: MEAN_OVER_PAIRS,
    exercises.check_pixels_per_index: PIXELS_PER_INDEX,
    exercises.check_sgm_step: SGM_STEP,
    exercises.check_parabola: PARABOLA,
    exercises.check_index_error: INDEX_ERROR,
    exercises.check_cosine_cost: COSINE_COST,
    exercises.check_hinge_loss: HINGE_LOSS,
    exercises.check_patch_size: PATCH_SIZE,
    exercises.check_sphere_labels: SPHERE_LABELS,
    exercises.check_balanced_loss: BALANCED_LOSS,
    exercises.check_receptive_field: RECEPTIVE_FIELD,
    exercises.check_share_above: SHARE_ABOVE,
    exercises.check_pooled_rms: POOLED_RMS,
    exercises.check_standard_error: STANDARD_ERROR,
    exercises.check_metres_per_unit: METRES_PER_UNIT,
    exercises.check_pose_from_file: POSE_FROM_FILE,
    exercises.check_spheres_needed: SPHERES_NEEDED,
    exercises.check_distance_from_z: DISTANCE_FROM_Z,
    exercises.check_share_of_sphere: SHARE_OF_SPHERE,
    exercises.check_risk_ratio: RISK_RATIO,
}
ALL_STUDENTS = [(check, words, answer) for check, students in STUDENTS.items() for words, answer in students]


def task(check, monkeypatch):
    """The inputs, the right value and the mistakes of a checker."""
    seen = []
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[check.__module__], "diagnose", lambda answer, *rest: seen.append(rest))
        check(None)
    return seen[0]


@pytest.mark.parametrize(("check", "words", "answer"), ALL_STUDENTS)
def test_student_is_told_what_is_wrong(check, words, answer, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert said == "right\n" if words == "right" else words in said and said.startswith("not yet: ")


def test_every_checker_has_students():
    assert set(STUDENTS) == set(CHECKERS)
    assert all([words for words, _ in students].count("right") >= 2 for students in STUDENTS.values())


@pytest.mark.parametrize("check", CHECKERS)
def test_every_hint_is_heard_by_a_student(check, monkeypatch):
    inputs, right, mistakes = task(check, monkeypatch)
    heard = {diagnose(answer, inputs, right, mistakes) for _, answer in STUDENTS[check]}
    assert {f"not yet: {hint}" for _, hint in mistakes} <= heard


@pytest.mark.parametrize("check", CHECKERS)
def test_right_value_and_mistakes_differ_by_more_than_single_precision(check, monkeypatch):
    _, right, mistakes = task(check, monkeypatch)
    assert np.isfinite(right).all()
    for one, other in combinations([right, *(value for value, _ in mistakes)], 2):
        assert np.shape(one) != np.shape(other) or not np.allclose(one, other, rtol=5e-4, atol=5e-6, equal_nan=True)


@pytest.mark.parametrize("check", CHECKERS)
def test_inputs_of_another_call_are_untouched(check, monkeypatch):
    """A student who overwrites the arguments changes neither the inputs nor what is compared."""
    inputs, right, mistakes = task(check, monkeypatch)
    before = [np.array(value) for value in inputs if isinstance(value, np.ndarray)]

    def overwrite(*arguments):
        for array in arguments:
            if isinstance(array, np.ndarray):
                array[...] = -7
        return right

    assert diagnose(overwrite, inputs, right, mistakes) == "right"
    for array, copy in zip([value for value in inputs if isinstance(value, np.ndarray)], before, strict=True):
        np.testing.assert_array_equal(array, copy)


# Garbage: what it is, and what the checker must tell to do next.


class Hostile:
    """Every way to look at it fails."""

    def __array__(self, *args, **kwargs):
        raise RuntimeError("no array")

    def __repr__(self):
        raise RuntimeError("no repr")

    __str__ = __len__ = __iter__ = __float__ = __eq__ = __repr__
    __hash__ = object.__hash__


class MuteError(Exception):
    """An exception that cannot be printed."""

    def __str__(self):
        raise ValueError("no text")


def raiser(error):
    def answer(*_):
        raise error

    return answer


def endless(*arguments):
    return endless(*arguments)


def generator(*_):
    yield 1.0


ragged_loop = []
ragged_loop.append(ragged_loop)

RETURNED = {
    "none": (None, "replace the ..."),
    "ellipsis": (..., "replace the ..."),
    "string": ("abc", "got str. Return real numbers"),
    "string of a number": ("1.5", "got str. Return real numbers"),
    "strings": (["1", "2"], "got a list that is no array of numbers. Return real numbers"),
    "bytes": (b"1", "got bytes. Return real numbers"),
    "truth value": (True, "got bool. Return real numbers"),
    "truth values": (np.ones(2, bool), "got an array of bool. Return real numbers"),
    "complex": (1 + 2j, "got complex. Return real numbers"),
    "complex array": (np.ones(3) * 1j, "got an array of complex128. Return real numbers"),
    "object": (object(), "got object. Return real numbers"),
    "hostile object": (Hostile(), "got Hostile. Return real numbers"),
    "objects": (np.array([None, 1]), "got an array of object. Return real numbers"),
    "fraction": (Fraction(1, 3), "got Fraction. Return real numbers"),
    "date": (np.datetime64("2019-05-20"), "got datetime64. Return real numbers"),
    "dict": ({"a": 1}, "got dict. Return real numbers"),
    "set": ({1.0}, "got set. Return real numbers"),
    "function": (abs, "got builtin_function_or_method. Return real numbers"),
    "generator": ((x for x in (1.0, 2.0)), "got generator. Return real numbers"),
    "None inside": ([None, 1.0], "got a list that is no array of numbers. Return real numbers"),
    "ellipsis inside": ([..., ...], "got a list that is no array of numbers. Return real numbers"),
    "ragged": ([[1.0, 2.0], [3.0]], "got a list that is no array of numbers. Return real numbers"),
    "list in itself": (ragged_loop, "got a list that is no array of numbers. Return real numbers"),
    "tuple of different things": (
        (np.zeros(2), "seen"),
        "got a tuple that is no array of numbers. Return real numbers",
    ),
    "tensor with a gradient": (torch.ones(3, requires_grad=True), "got Tensor. Return real numbers"),
    "wrong shape": (np.zeros((3, 5, 7)), "of shape (3, 5, 7). Look at the axes"),
    "empty": ([], "of shape (0,). Look at the axes"),
    "empty tuple": ((), "of shape (0,). Look at the axes"),
}
CALLED = {
    "exception": (raiser(KeyError("D_min")), "stopped with KeyError: 'D_min'. Call it"),
    "unprintable exception": (raiser(MuteError()), "Call it with numbers of your own"),
    "assertion": (raiser(AssertionError()), "stopped with AssertionError. Call it"),
    "TypeError inside": (lambda *_: ... + 1, "stopped with TypeError: unsupported"),
    "exit": (raiser(SystemExit(1)), "stopped with SystemExit: 1. Call it"),
    "endless recursion": (endless, "stopped with RecursionError"),
    "no arguments": (lambda: 1.0, "arguments: keep its first line as it was"),
    "too many arguments": (lambda a, b, c, d, e, f, g: 1.0, "arguments: keep its first line as it was"),
    "generator function": (generator, "got generator. Return real numbers"),
    "class": (Hostile, "keep its first line as it was"),
    "called already": (2.5, "hand over the function itself"),
    "nothing": (None, "hand over the function itself"),
    "text": ("depth", "hand over the function itself"),
}
GARBAGE = [
    *(pytest.param(lambda *_, it=value: it, words, id=name) for name, (value, words) in RETURNED.items()),
    *(pytest.param(answer, words, id=name) for name, (answer, words) in CALLED.items()),
]


@pytest.mark.parametrize("check", CHECKERS)
@pytest.mark.parametrize(("answer", "words"), GARBAGE)
def test_garbage_gets_the_next_thing_to_try(check, answer, words, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert words in said and said.count("\n") == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("check", CHECKERS)
def test_not_finite(check, bad, monkeypatch):
    inputs, right, _ = task(check, monkeypatch)
    found = np.array(right, np.float64)
    found[(0,) * found.ndim] = bad
    assert "Look for a division by zero" in diagnose(lambda *_: found, inputs, right, [])


@pytest.mark.parametrize("check", CHECKERS)
def test_unknown_mistake(check, monkeypatch):
    inputs, right, mistakes = task(check, monkeypatch)
    said = diagnose(lambda *_: np.asarray(right) * 1.37, inputs, right, mistakes)
    worst = float(said.split("off by up to ")[1].split(",")[0])
    assert worst == pytest.approx(0.37 * np.abs(right).max(), rel=0.01)
    assert said.endswith("Work out one value by hand and compare")


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (-1, "other sign"),
        (2, "twice"),
        (0.5, "half"),
        (100, "100 times"),
        (0.01, "hundredth"),
        (math.degrees(1), "are there degrees"),
        (math.radians(1), "are there radians"),
    ],
)
def test_common_factor(factor, words):
    right = np.array([1.5, 0.0, -3.0])
    assert words in diagnose(lambda x: x * np.float32(factor), (right,), right, [])


@pytest.mark.parametrize("error", [KeyboardInterrupt, GeneratorExit])
def test_interrupt_is_not_swallowed(error):
    with pytest.raises(error):
        exercises.check_parabola(raiser(error()))


def test_what_a_student_prints_stays_and_the_finding_comes_last(capsys):
    def talkative(left, middle, right):
        print("left is", left)
        return vertex_of_fit(left, middle, right)

    exercises.check_parabola(talkative)
    assert capsys.readouterr().out == "left is 0.5\nright\n"
