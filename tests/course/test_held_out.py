"""Answers that no checker was written for: right ones by another way, and wrong ones that look right.

Each is a change of the solution or another body, as in `course.exercises`; behind it stands whether it is right.
"""

import numpy as np
import pytest

from course import exercises, nbtools
from course.exercises.compare import RIGHT
from course.exercises.opened import Open, changed

OPENED = {
    f.name: f for path in nbtools.notebooks() for f in exercises.functions(nbtools.number(path))
}
ANSWERS = """
depth_of_index
    return np.divide(min_depth * (N - 1), index, out=np.full(np.shape(index), np.inf), where=np.asarray(index) > 0)
    # right
    return min_depth * (N - 1) / np.maximum(index, 1e-12)  # wrong: 1e12 m are not infinity
    (N - 1) → N  # wrong
index_errors
    e = np.full(gt_index.shape, 100.0)
    known = np.isfinite(index)
    e[known] = 100 / N * np.abs(index[known] - gt_index[known])
    e[np.isnan(gt_index)] = np.nan
    return e
    # right
    np.where(np.isnan(gt_index), np.nan, e) → e  # wrong
    return np.where(np.isnan(gt_index), np.nan, e) → return np.minimum(np.where(np.isnan(gt_index), np.nan, e), 10)
    # wrong
share_above
    return np.count_nonzero(errors > limit) / np.count_nonzero(~np.isnan(errors)) * 100  # right
    return np.mean(errors > limit) * 100  # wrong: NaN counts as a ray
stitched
    return np.nanmean(warped, axis=0)  # right
    return np.ma.masked_invalid(warped).mean(axis=0)  # right
    return np.nanmedian(warped, axis=0)  # wrong
unproject
    x, y = np.asarray(pixels)[..., 0] - center[0], np.asarray(pixels)[..., 1] - center[1]
    rays = np.stack([x, y, -sum(a * np.hypot(x, y) ** k for k, a in enumerate(poly))], axis=-1)
    return rays / np.sqrt((rays**2).sum(axis=-1))[..., None]
    # right
    z = -np.polyval(poly[::-1], r) → z = -np.polynomial.polynomial.polyval(r, poly)  # right
    z = -np.polyval(poly[::-1], r) → z = np.polyval(poly[::-1], r)  # wrong
project_rays
    r = np.polyval(inv_poly[::-1], np.arctan2(-z, n)) → r = np.polyval(inv_poly[::-1], np.arccos(z / np.sqrt(x*x + y*y + z*z)) - np.pi / 2)
    # right
    around = np.arctan2(rays[..., 1], rays[..., 0])
    theta = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    r = sum(b * (theta - np.pi / 2) ** k for k, b in enumerate(inv_poly))
    r = np.where((rays[..., 0] == 0) & (rays[..., 1] == 0), 0, r)
    pixels = np.stack([r * np.cos(around) + center[0], r * np.sin(around) + center[1]], axis=-1)
    pixels[np.degrees(theta) > max_deg] = np.nan
    return pixels
    # right
    np.degrees(np.arctan2(n, z)) <= max_deg → np.degrees(np.arctan2(n, z)) <= max_deg / 2  # wrong
planar_pose
    r1, r2 = (U @ Vt).T → r1 = H[:, 0] / np.linalg.norm(H[:, 0]); r2 = H[:, 1] - r1 * (r1 @ H[:, 1]); r2 = r2 / np.linalg.norm(r2)
    # right: Gram and Schmidt
    H *= np.sign(np.sum(rays * (plane @ H.T))) → H *= np.sign(rays[0] @ (plane @ H.T)[0])
    # right: the corners lie on one side all together
    2 / np.linalg.norm(H[:, :2], axis=0).sum() → np.sqrt(2) / np.linalg.norm(H[:, :2])  # right
    H *= 2 / np.linalg.norm(H[:, :2], axis=0).sum() → H /= np.linalg.norm(H[:, 2])  # wrong
residuals
    found_at = Rotation.from_rotvec(pose[:3]).as_matrix() @ points.T + pose[3:, None]
    n = np.linalg.norm(found_at[:2], axis=0)
    theta = np.arctan2(n, found_at[2])
    r = lens[0] * theta + lens[1] * theta**2 + lens[2] * theta**3 + lens[3] * theta**4
    return (found_at[:2] / n * r).T + lens[4:] - found
    # right
    np.arctan2(n, z) → np.arccos(z / np.sqrt(n**2 + z**2))  # right
ocam_polynomial
    powers = [0, *range(2, degree + 1)]
    scaled = r / r.max()
    A = np.stack([scaled**p for p in powers], axis=1)
    a = np.zeros(degree + 1)
    a[powers] = np.linalg.pinv(A) @ (-r / np.tan(theta)) / r.max() ** np.array(powers)
    return a
    # right
relative_pose
    < 0.02 → < 1e-6  # wrong: no two measured poses agree so well
    np.linalg.norm(t - t[:, None], axis=-1) → np.abs(t - t[:, None])[..., 2]  # wrong: z alone
    np.linalg.norm(t - t[:, None], axis=-1) → np.abs(t - t[:, None])[..., 0]  # wrong: x alone
    np.linalg.norm(t - t[:, None], axis=-1) → np.abs(t - t[:, None])[..., 1]  # wrong: y alone
    proposals[np.argmax(agree.sum(axis=1))] → proposals[np.flatnonzero(agree.sum(axis=1) == agree.sum(axis=1).max())[-1]]
    # right: another one of those that agree
    < 0.02 → < 0.03  # right
poses_of_cameras
    poses = [None] * cameras
    poses[0] = osl.Pose.identity()
    while any(pose is None for pose in poses):
        for (i, j), T in links.items():
            if (poses[i] is None) != (poses[j] is None):
                if poses[i] is None:
                    poses[i] = poses[j] @ T.inverse()
                else:
                    poses[j] = poses[i] @ T
                break
    return poses
    # right
bundle_residuals
    return np.array([lenses[i].project((T_rig_cam[i].inverse() @ T_rig_board[k]) @ points)[0] - corners for i, k, corners in zip(camera, capture, found)])
    # right
covariance
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    return (residuals**2).sum() / (J.shape[0] - J.shape[1]) * (Vt.T / s**2) @ Vt
    # right
    residuals @ residuals / (m - n) → np.var(residuals)  # wrong
    residuals @ residuals / (m - n) → np.var(residuals, ddof=n)  # wrong: the mean is subtracted
    np.linalg.inv(J.T @ J) → np.linalg.pinv(J.T @ J)  # right
sphere_shift
    at = [grid.rays() * grid.index_to_depth(index)[..., None], grid.index_to_depth(index), grid.index_to_depth(index + 1)]
    dot = length = 0
    for i, j in pairs:
        p, e = (
            np.subtract(*(shown_beside(rig.cameras[k], rig.T_rig_cam[k], used.T_rig_cam[k], at[0], radius) for k in (i, j)))
            for used, radius in ((rig, at[2]), (wrong_rig, at[1]))
        )
        dot = dot + np.nan_to_num((p * e).sum(-1))
        length = length + np.nan_to_num((p * p).sum(-1))
    return np.where(length == 0, np.nan, -dot / length)
    # right: pair by pair
rays_of_pixels
    theta, low, high = (columns + 0.5) / width * 2 * np.pi - np.pi, *np.radians(phi_deg)
    phi = low + (np.asarray(rows) + 0.5) / height * (high - low)
    return np.moveaxis(np.array([np.cos(phi) * np.sin(theta), np.sin(phi), np.cos(phi) * np.cos(theta)]), 0, -1)
    # right
    (rows + 0.5) * (high - low) / height → rows * (high - low) / (height - 1)  # wrong
    columns + 0.5 → columns  # wrong
points_on_sphere
    return rays * (min_depth * (N - 1) / n if n else 2.0**23)  # right
    2.0**-23 → 1e-9  # wrong: the paper's sphere 0 is at 2²³ m
look_up
    image, pixels = image.astype(np.float32), pixels.astype(np.float32)
    u, v = pixels[..., 0], pixels[..., 1]
    x = np.clip(np.floor(np.nan_to_num(u)).astype(int), 0, image.shape[1] - 2)
    y = np.clip(np.floor(np.nan_to_num(v)).astype(int), 0, image.shape[0] - 2)
    a, b = u - x, v - y
    top = image[y, x] * (1 - a) + image[y, x + 1] * a
    return top * (1 - b) + (image[y + 1, x] * (1 - a) + image[y + 1, x + 1] * a) * b
    # right: in float32
    import cv2
    maps = np.nan_to_num(pixels).astype(np.float32).reshape(-1, 1, 2)
    values = cv2.remap(image.astype(np.float32), maps, None, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.where(np.isnan(pixels[..., 0]), np.nan, values.reshape(pixels.shape[:-1]))
    # right: by OpenCV
    from scipy.ndimage import map_coordinates
    values = map_coordinates(image.astype(float), np.nan_to_num(pixels[..., ::-1]).reshape(-1, 2).T, order=1, mode="nearest")
    return np.where(np.isnan(pixels[..., 0]), np.nan, values.reshape(pixels.shape[:-1]))
    # right: by SciPy
    a, b = u - x, v - y → a, b = np.rint(u - x), np.rint(v - y)  # wrong
disagreement
    found = np.ma.masked_invalid(warped)
    return np.ma.masked_where(found.count(axis=0) < 2, found.std(axis=0))
    # right: a masked array
    return np.where(np.isfinite(warped).sum(axis=0) < 2, np.nan, np.nanstd(warped, axis=0))  # right
    return np.nanstd(warped, axis=0)  # wrong: one camera agrees with itself
zncc
    a, b = a - a.mean(), b - b.mean()
    length = np.linalg.norm(a) * np.linalg.norm(b)
    return (a * b).sum() / length if length else 0.0
    # right
    if a.std() < 1e-9 or b.std() < 1e-9:
        return 0.0
    return np.corrcoef(a.ravel(), b.ravel())[0, 1]
    # right
window_sums
    from scipy.ndimage import convolve1d
    ones = np.ones(2 * radius + 1)
    return convolve1d(convolve1d(image, ones, axis=1, mode="wrap"), ones, axis=0, mode="constant")
    # right
    return sum(np.roll(np.pad(image, ((radius, radius), (0, 0)))[k : k + len(image)], j, axis=1) for k in range(2 * radius + 1) for j in range(-radius, radius + 1))
    # right
zncc_costs
    np.sqrt(np.maximum(variance_a * variance_b, 1e-12)) → (np.sqrt(np.maximum(variance_a * variance_b, 0)) + 1e-6)
    # right: another guard
    (1 - zncc) / 2, np.nan → np.clip((1 - zncc) / 2, 0, 1), np.nan  # right
    count = np.maximum(window_sums(both.astype(float), radius), 1) → count = (2 * radius + 1) ** 2  # wrong
mean_of_pairs
    return np.nanmean(costs, axis=0)  # right
    return np.ma.masked_invalid(costs).mean(axis=0)  # right
    return np.nan_to_num(costs).mean(axis=0)  # wrong
    return np.nanmedian(costs, axis=0)  # wrong
winner
    np.inf, costs → 1.0, costs  # wrong: path costs are larger
    found = np.ma.masked_invalid(costs)
    return np.ma.masked_where(np.isnan(costs).all(axis=-1), found.argmin(axis=-1).astype(float))
    # right
    costs = np.where(np.isnan(costs), costs[np.isfinite(costs)].max() + 1, costs)
    return costs.argmin(axis=-1)
    # wrong: a ray without costs has no sphere
tower
    return x / x.norm(dim=1, keepdim=True).clamp(min=1e-6) → return nn.functional.normalize(x, dim=1)  # right
    return x / x.norm(dim=1, keepdim=True).clamp(min=1e-6) → return x / (x.norm(dim=1, keepdim=True) + 1e-8)  # right
hinge
    return (margin + non_match - match).clamp(min=0).mean()  # right
    return nn.functional.margin_ranking_loss(match, non_match, torch.ones_like(match), margin)  # right
    return (margin + non_match - match).abs().mean()  # wrong
balanced_loss
    label = label.clone()
    each = nn.functional.binary_cross_entropy_with_logits(score, label, reduction="none")
    parts = [each[label == k].sum() / (2 * (label == k).sum()) for k in (0, 1) if (label == k).any()]
    return sum(parts)
    # right
step
    padded = np.pad(before, [(0, 0)] * (before.ndim - 1) + [(1, 1)], constant_values=np.inf)
    lowest = before.min(axis=-1, keepdims=True)
    ways = [before, padded[..., :-2] + p1, padded[..., 2:] + p1, np.broadcast_to(lowest + p2, before.shape)]
    return cost + np.min(ways, axis=0) - lowest
    # right
    lowest + p2) - lowest → before + p2) - lowest  # wrong
sum_of_paths
    H, W, N = volume.shape
    total = 0
    for down, right in directions:
        found, laps = volume.copy(), 1 if down else 4
        ys = range(H)[:: down or 1]
        xs = [x % W for x in range(laps * W)][:: right or 1]
        if down:
            for y in list(ys)[1:]:
                found[y] = step(volume[y], found[y - down][(np.arange(W) - right) % W], p1, p2)
        else:
            for x in xs[1:]:
                found[:, x] = step(volume[:, x], found[:, (x - right) % W], p1, p2)
        total = total + found
    return total
    # right: ray by ray along the rows
    path[-1], right if down else 0 → path[-1], -right if down else 0  # wrong: from the other side
refined
    n = costs.argmin(axis=-1)
    found = n.astype(float)
    for y, x in np.ndindex(n.shape):
        k = n[y, x]
        if 0 < k < costs.shape[-1] - 1:
            a, b, c = np.polyfit([-1, 0, 1], costs[y, x, k - 1 : k + 2].astype(float), 2)
            found[y, x] += -b / (2 * a)
    return found
    # right: by np.polyfit
mean_error_of_the_rest
    known = np.isfinite(error + confidence)
    order = np.argsort(-confidence[known])
    ranked = error[known][order]
    return [ranked[: len(ranked) - int(fraction * len(ranked))].mean() for fraction in fractions]
    # right: the surest first
metrics
    e = 100 / N * abs(index - gt_index)[~np.isnan(gt_index)]
    e[np.isnan(e)] = 100
    return [*(100 * (e > k).sum() / e.size for k in (1, 3, 5)), e.sum() / e.size, (e @ e / e.size) ** 0.5]
    # right: a list
depth_regions
    fraction = gt_index / (N - 1)
    region = np.digitize(fraction, [np.nextafter(0, 1), 1 / 3, 2 / 3]).astype(float)
    region[np.isnan(gt_index)] = np.nan
    return region
    # right
    return np.where(np.isnan(gt_index), np.nan, np.floor(3 * gt_index / (N - 1)))  # wrong
interval
    means = np.array([values[draw].mean(axis=0) for draw in draws])
    return np.quantile(means, [0.025, 0.975], axis=0)
    # right
    means = values[draws].mean(axis=1)
    return np.stack([means.mean(axis=0) - 1.96 * means.std(axis=0), means.mean(axis=0) + 1.96 * means.std(axis=0)])
    # wrong: a normal distribution was not asked for
verdict
    return np.select([abs(ours - paper) <= 0.2 * paper, (ours - 1) * (paper - 1) > 0], [2, 1], 0)  # right
clock_offset
    < 0.5 → < 1e-6  # wrong: no clock is so exact
    differences = (times_b[:, None] - times_a).ravel()
    return differences[np.argmax(np.isclose(differences, differences[:, None]).sum(axis=1))]
    # wrong
    differences = np.round((times_b[:, None] - times_a).ravel(), 2)
    values, counts = np.unique(differences, return_counts=True)
    return values[np.argmax(counts)]
    # wrong: rounded to a hundredth
    differences = (times_b[:, None] - times_a).ravel()
    near = np.abs(differences - differences[:, None]) < 0.5
    return np.median(differences[near[np.argmax(near.sum(axis=1))]])
    # right: the median of those that agree
moments
    seconds = np.concatenate([card - clock_offset(times[0], card) for card in times])
    order = np.argsort(seconds)
    numbers = np.empty(len(seconds), int)
    numbers[order] = 1 + np.cumsum(np.diff(seconds[order], prepend=seconds[order[0]]) > 2)
    return numbers
    # right: all by the first card
    > 2: → > 0.05:  # wrong: a card notes the time when it wrote the picture
matching_cost
    return np.nanmedian(np.nanmin(volume, axis=-1))  # right
    return np.nanmean(np.nanmin(volume, axis=-1))  # wrong
shift_between
    fade * (picture - picture.mean()) → picture - picture.mean()  # wrong: the lamp does not move
    picture - picture.mean() → picture  # right: a constant is one frequency of many
spheres_needed
    return 1 + int(-(-baseline / nearest * width / (2 * np.pi) // pixels))  # right
hit_box
    t = np.stack([(low - origins) / rays, (high - origins) / rays])
    t0, t1 = t.min(axis=0).max(axis=-1), t.max(axis=0).min(axis=-1)
    return np.select([(t1 < t0) | (t1 <= 0), t0 > 0], [np.inf, t0], t1)
    # right
checker
    x, y, z = np.moveaxis(np.floor(points / size).astype(int), -1, 0)
    return np.where((x ^ y ^ z) & 1, 0.2, 0.8)
    # right
solid_angles
    low, high = np.radians(phi_deg)
    edges = low + (high - low) * np.arange(height + 1) / height
    return np.repeat((2 * np.pi / width * (np.sin(edges[1:]) - np.sin(edges[:-1])))[:, None], width, axis=1)
    # right
    low, high = np.radians(phi_deg)
    middle = low + (high - low) * (np.arange(height) + 0.5) / height
    return np.tile((2 * np.pi / width * (high - low) / height * np.cos(middle))[:, None], width)
    # wrong: exact only for thin rows
blend
    seen = np.isfinite(images[..., 0])
    weights = np.ma.masked_array(half_fov - angles, ~seen)
    weights = (weights / weights.sum(axis=0))[..., None].filled(0)
    return np.where(seen.any(axis=0)[..., None], (weights * np.nan_to_num(images)).sum(axis=0), np.nan)
    # right
    half_fov - angles, 0 → (half_fov - angles) ** 2, 0  # wrong
pick
    score = np.where(np.isnan(score), -9e9, score)
    return np.choose(score.argmax(axis=0), index)
    # right
quads
    cells = []
    H, W = depth.shape
    for x in range(W):
        for y in range(H - 1):
            corners = [(y, x), (y + 1, x), (y + 1, (x + 1) % W), (y, (x + 1) % W)]
            d = [depth[c] for c in corners]
            if np.isfinite(d).all() and max(d) <= (1 + limit) * min(d):
                cells.append([r * W + c for r, c in corners])
    return np.array(cells)
    # right: column by column
correlation
    seen = ~f[..., 0].isnan()
    total, f = torch.zeros(*f.shape[1:-1], 8, dtype=f.dtype), f.nan_to_num()
    count = torch.zeros(f.shape[1:-1], dtype=f.dtype)
    for i in range(len(f)):
        for j in range(i):
            total += (f[i] * f[j]).unflatten(-1, (8, 4)).mean(-1)
            count += seen[i] & seen[j]
    return total / count.clamp(min=1)[..., None]
    # right: pair by pair
cross_entropy
    n = torch.arange(scores.shape[-1])
    target = (1 - (index[:, None] - n).abs()).clamp(min=0)
    return -(target * scores.log_softmax(-1)).sum(-1).mean()
    # right: triangles
    return torch.nn.functional.cross_entropy(scores, index.round().long())  # wrong: rounded
read_out
    n = torch.arange(p.shape[-1])
    best = p.argmax(-1, keepdim=True)
    near = torch.where((n - best).abs() <= radius, p, torch.zeros_like(p))
    return (near / near.sum(-1, keepdim=True)) @ n.to(p.dtype)
    # right
epipolar_residual
    n = np.cross(T_21.t, (T_21.R @ x.T).T)
    return np.degrees(np.arcsin(np.einsum("ij,ij->i", n, y) / np.linalg.norm(n, axis=1)))
    # right
    n = np.cross(T_21.t, (T_21.R @ x.T).T)
    return 90 - np.degrees(np.arccos(np.einsum("ij,ij->i", n, y) / np.linalg.norm(n, axis=1)))
    # right
robust_weight
    return scale**4 / (scale**2 + residuals**2) ** 2  # right
    return scale**2 / (scale**2 + residuals**2)  # wrong: Cauchy's
march
    found = np.full(distance.shape[:-1], np.nan)
    for place in np.ndindex(found.shape):
        d = distance[place]
        for k in range(len(radii) - 1):
            if d[k] > 0 and d[k + 1] <= 0:
                found[place] = np.interp(0, [-d[k], -d[k + 1]], radii[k : k + 2])
                break
    return found
    # right: a loop
mix
    apart < 0.1 * own → apart < 0.1 * fused  # wrong
"""


def table():
    function, text = None, {}
    for line in ANSWERS.strip().splitlines():
        if line in OPENED:
            function = line
        text[function] = text.get(function, "") + (line + "\n" if line != function else "")
    for name, lines in text.items():
        answers = Open(OPENED[name].answer, OPENED[name].draw).with_slips(lines).slips
        for k, (answer, verdict) in enumerate(answers):
            yield pytest.param(
                OPENED[name], answer, verdict, id=f"{name} {k} {verdict.partition(':')[0]}"
            )


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("function", "answer", "verdict"), list(table()))
def test_what_is_right_is_accepted_and_what_is_wrong_is_not(function, answer, verdict):
    own = changed(function.answer, answer)
    with np.errstate(all="ignore"):
        said = function.check(own)
        if said == RIGHT and function.real:
            said = function.diagnose(own, [function.real()])
    assert (said == RIGHT) == verdict.startswith("right"), said
