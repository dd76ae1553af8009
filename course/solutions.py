"""The solutions of the notebooks' exercises: one function for each stub, with its name and its arguments.

`python course/solve.py` puts them in the place of the stubs. They use what every notebook has imported, numpy
as np, and are written as on a board: one step a line, the reason beside it.
"""

import numpy as np

# --- 00 Quickstart ----------------------------------------------------------------------------------------


def index_to_depth(n, N, nearest):
    # N spheres have N - 1 steps between them, from 0 at infinity to 1 / nearest, even in inverse depth.
    step = 1 / (nearest * (N - 1))
    return 1 / (n * step)


# --- 01 Fisheye model -------------------------------------------------------------------------------------


def my_ray(u, v, poly, center):
    x, y = u - center[0], v - center[1]
    r = np.hypot(x, y)
    # np.polyval wants the highest coefficient first. f is negative before the lens, z points forward.
    z = -np.polyval(poly[::-1], r)
    ray = np.array([x, y, z])
    return ray / np.linalg.norm(ray)


def my_angle(ray):
    x, y, z = ray
    # arctan2 knows the quadrant, so it is right beyond 90°, and the ray's length cancels.
    return np.degrees(np.arctan2(np.hypot(x, y), z))


def my_rms(residuals):
    # Square, mean, root; the mean runs over all 2K numbers, u and v alike.
    return np.sqrt(np.mean(residuals**2))


# --- 02 Rig calibration -----------------------------------------------------------------------------------


def my_relative_pose(T_1_board, T_2_board):
    # Read from the right: camera 1 -> board, then board -> camera 2. The inner indices meet.
    return T_2_board @ T_1_board.inverse()


def my_unknowns(cameras, captures, degree):
    coefficients = degree  # a0, a2, a3 … aM: there is no a1
    lenses = cameras * (2 + 2 + coefficients)  # centre; c and d = e; polynomial
    poses = (cameras - 1) + captures  # camera 1 is the rig's frame; one board for each capture
    return lenses + 6 * poses


def my_depth_error(depth, N, nearest):
    step = 1 / (nearest * (N - 1))  # in inverse depth
    # depth = 1/d, so its derivative is -1/d², which is -depth².
    return depth**2 * step


# --- 03 Sphere sweep --------------------------------------------------------------------------------------


def point_of_ray(theta, phi, depth):
    # θ turns from z towards x, φ from the horizon towards y, which points down.
    x = np.cos(phi) * np.sin(theta)
    y = np.sin(phi)
    z = np.cos(phi) * np.cos(theta)
    return depth * np.array([x, y, z])


def pixel_of_point(camera, T_rig_cam, point):
    # The pose takes camera -> rig; the point goes the other way.
    in_camera = T_rig_cam.inverse() @ point
    pixel, _ = camera.project(in_camera)
    return pixel


def shift_of_yaw_error(degrees, width):
    # 360 degrees of yaw are once around the panorama, all its columns.
    return degrees / 360 * width


# --- 04 ZNCC ----------------------------------------------------------------------------------------------


def zncc_cost(a, b):
    a, b = a - a.mean(), b - b.mean()  # Z: brightness does not count
    zncc = np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2))  # N: contrast does not, either
    return (1 - zncc) / 2  # from 1 … -1 to 0 … 1


def mean_over_pairs(costs):
    # Over the rows, and only over those that hold a number: a pair that does not see the ray has no say.
    return np.nanmean(costs, axis=0)


def pixels_per_index(baseline, nearest, N, width):
    step = 1 / (nearest * (N - 1))  # from one sphere to the next, in inverse depth
    angle = baseline * step  # radians
    return angle / (2 * np.pi) * width


# --- 05 MC-CNN --------------------------------------------------------------------------------------------


def my_cosine_cost(f_i, f_j):
    # The lengths leave the direction alone to be compared.
    cosine = f_i @ f_j / (np.linalg.norm(f_i) * np.linalg.norm(f_j))
    return (1 - cosine) / 2


def my_hinge(positive, negative, margin):
    # A ray whose match is ahead by more than the margin costs nothing, however far it is ahead.
    each = np.maximum(0, margin + negative - positive)
    return each.mean()


def my_patch_size(layers, kernel):
    # One pixel sees itself; each convolution adds half a kernel on both sides.
    return 1 + layers * (kernel - 1)


# --- 06 SweepNet ------------------------------------------------------------------------------------------


def my_labels(gt_index, n):
    labels = np.where(np.rint(gt_index) == n, 0.0, 1.0)  # a match is 0, as in every cost
    return np.where(np.isnan(gt_index), np.nan, labels)  # NaN equals nothing: it would become a 1


def my_loss(cost, label):
    # The cost is the probability of *no* match. Two means, so that neither kind wins by its number.
    positives = -np.log(1 - cost[label == 0]).mean()
    negatives = -np.log(cost[label == 1]).mean()
    return (positives + negatives) / 2


def my_receptive_field(layers):
    size, pixel = 1, 1  # in pixels of the input: what one value sees, and how far its neighbour's view lies
    for kernel, stride in layers:
        size += (kernel - 1) * pixel
        pixel *= stride  # counts for the layers behind this one
    return size


# --- 07 SGM -----------------------------------------------------------------------------------------------


def my_step(cost, before, p1, p2):
    best = before.min()
    padded = np.pad(before, 1, constant_values=np.inf)  # no way leads in from beyond the first and the last sphere
    ways = np.minimum(padded[:-2], padded[2:]) + p1  # from a neighbour
    ways = np.minimum(ways, before)  # from the same sphere, for nothing
    ways = np.minimum(ways, best + p2)  # from anywhere
    return cost + ways - best  # less the best, or the sums would grow along the path


def vertex(left, middle, right):
    # Through -1, 0, 1 goes a x² + b x + c with these a and b; its derivative 2 a x + b is zero at -b / 2a.
    a = (left - 2 * middle + right) / 2
    b = (right - left) / 2
    return -b / (2 * a)


def mean_index_error(index, truth, N):
    error = 100 / N * np.abs(index - truth)
    return np.nanmean(error)  # a ray without an estimate is neither added nor counted


# --- 08 Evaluation ----------------------------------------------------------------------------------------


def my_share_above(error, limit):
    right = error <= limit  # False for NaN, too, which is how no estimate counts as wrong
    return 100 * np.mean(~right)


def my_pooled_rms(rays, sums, squares):
    # First add up over the frames, then divide, then take the root. Σ e is not needed.
    return np.sqrt(squares.sum() / rays.sum())


def my_standard_error(a, b):
    # Both methods saw the same frames, so subtract frame by frame: what makes a frame hard cancels.
    difference = a - b
    deviation = difference.std(ddof=1)  # n - 1: the mean was taken from the same frames
    return deviation / np.sqrt(len(difference))


# --- 09 Your own rig --------------------------------------------------------------------------------------


def my_metres_per_unit(positions, i, j, measured):
    in_file = np.linalg.norm(positions[j] - positions[i])  # the distance does not care where the origin is
    return measured / in_file


def my_pose(matrix):
    R, t = matrix[:3, :3], matrix[:3, 3] / 1000  # millimetres -> metres; a rotation has no unit
    pose = np.eye(4)
    pose[:3, :3] = R.T  # rig -> camera becomes camera -> rig: p = R q + t gives q = Rᵀ(p - t)
    pose[:3, 3] = -R.T @ t
    return pose


def my_num_spheres(baseline, nearest, width, pixels):
    parallax = baseline / nearest / (2 * np.pi) * width  # from infinity to the nearest sphere, in pixels
    steps = np.ceil(parallax / pixels)  # rounded up: a step may be smaller, not larger
    return int(steps) + 1  # steps are between spheres


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


# --- 11 Gallery -------------------------------------------------------------------------------------------


def my_risk_ratio(agree, wrong):
    # The groups differ in size, so shares are compared, not numbers.
    return wrong[~agree].mean() / wrong[agree].mean()


# --- 12 After SweepNet ------------------------------------------------------------------------------------


def my_correlation(f):
    seen = f[~np.isnan(f).any(axis=1)]
    k = len(seen)
    # (Σ f)² holds every product f_i f_j, i = j included; those are Σ f².
    return (seen.sum(0) ** 2 - (seen**2).sum(0)) / (k * (k - 1))


def my_local_mean(p):
    best = p.argmax()
    n = np.arange(max(best - 2, 0), min(best + 3, len(p)))  # fewer than five at the ends
    return p[n] @ n / p[n].sum()


def my_target(index, N):
    # A sphere at the index gets 1, one at a distance of 1 or more gets nothing: a triangle.
    return np.maximum(0, 1 - np.abs(np.arange(N) - index))


# --- 13 The whole method on one page ----------------------------------------------------------------------


def my_points(depth, theta, phi):
    x = np.cos(phi)[:, None] * np.sin(theta)
    y = np.sin(phi)[:, None] * np.ones_like(theta)
    z = np.cos(phi)[:, None] * np.cos(theta)
    return depth[..., None] * np.stack([x, y, z], axis=-1)  # a ray has the length 1, so depth stretches it


def my_two_walks(costs, p1, p2):
    def walk(costs):
        lines = [costs[0]]
        for cost in costs[1:]:
            before = lines[-1]
            padded = np.pad(before, 1, constant_values=np.inf)
            ways = np.minimum(np.minimum(padded[:-2], padded[2:]) + p1, np.minimum(before, before.min() + p2))
            lines.append(cost + ways - before.min())
        return np.array(lines)

    return walk(costs) + walk(costs[::-1])[::-1]
