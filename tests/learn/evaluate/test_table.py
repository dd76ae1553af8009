"""Metrics and regions against definitions ray by ray, intervals, tables, records."""

import csv
import io
import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
import scene
from hypothesis import given
from hypothesis import strategies as st

import omnistereo_lib as osl
from omnistereo_learn.evaluate import Table, errors_table, regions_table
from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_learn.evaluate.records import write_record
from omnistereo_learn.evaluate.regions import (
    METRICS,
    SUMS,
    error_sums,
    find_regions,
    near_edges,
    sums_to_metrics,
    thin_objects,
)
from omnistereo_learn.evaluate.table import bootstrap
from omnistereo_lib.files import read_data

RIG = scene.rig(width=200, height=192)


# ---- metrics


def brute_metrics(errors):
    if not errors:
        return [np.nan] * 5
    above = [100 * sum(e > limit for e in errors) / len(errors) for limit in (1, 3, 5)]
    return [*above, sum(errors) / len(errors), (sum(e * e for e in errors) / len(errors)) ** 0.5]


def brute_errors(index, gt_index, num_spheres, mask):
    """The errors of the paper, ray by ray in Python floats."""
    errors = []
    for estimate, gt, wanted in zip(index.ravel(), gt_index.ravel(), mask.ravel(), strict=True):
        if wanted and 0 <= gt < num_spheres:
            off = abs(float(estimate) - float(gt))
            errors.append(100.0 if np.isnan(estimate) else 100 / num_spheres * off)
    return errors


def random_maps(seed=0):
    shape, num_spheres = (9, 31), 48
    rng = np.random.default_rng(seed)
    gt_index = rng.uniform(-3, num_spheres + 3, shape)
    index = rng.integers(0, num_spheres, shape).astype(np.float32)
    gt_index[rng.random(shape) < 0.1] = np.nan
    index[rng.random(shape) < 0.1] = np.nan
    close = rng.random(shape) < 0.6
    index[close] = np.rint(gt_index[close])
    return index, gt_index


def test_sums_and_metrics_agree_with_the_definition():
    index, gt_index = random_maps()
    masks = {
        "all": np.ones(gt_index.shape, bool),
        "some": np.random.default_rng(9).random(gt_index.shape) < 0.3,
    }
    found = error_sums(index, gt_index, 48, masks)
    for name, mask in masks.items():
        errors = brute_errors(index, gt_index, 48, mask)
        assert found[name]["rays"] == len(errors) > 50
        assert found[name]["sum"] == pytest.approx(sum(errors), rel=1e-12)
        of_sums = sums_to_metrics([found[name][key] for key in SUMS])
        np.testing.assert_allclose(of_sums, brute_metrics(errors), rtol=1e-12)
        np.testing.assert_allclose(
            of_sums, list(osl.index_error(index, gt_index, 48, mask).values()), rtol=1e-12
        )


def test_sums_of_frames_add_up():
    everywhere = {"all": np.ones((9, 31), bool)}
    maps = [random_maps(seed) for seed in range(4)]
    sums = [list(error_sums(*pair, 48, everywhere)["all"].values()) for pair in maps]
    together = [np.concatenate(side) for side in zip(*maps, strict=True)]
    expected = brute_metrics(brute_errors(*together, 48, np.ones((36, 31), bool)))
    np.testing.assert_allclose(sums_to_metrics(np.sum(sums, 0)), expected, rtol=1e-12)


DEGENERATE = {
    "no estimate": (np.full((4, 6), np.nan), np.full((4, 6), 3.2), [100, 100, 100, 100, 100]),
    "sky missed": (np.full((4, 6), 2.0), np.zeros((4, 6)), [100, 100, 100, 10, 10]),
    "no ground truth": (np.full((4, 6), 7.0), np.full((4, 6), np.nan), [np.nan] * 5),
    "ground truth out of range": (np.full((4, 6), 7.0), np.full((4, 6), 20.0), [np.nan] * 5),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_maps(name):
    index, gt_index, expected = DEGENERATE[name]
    sweep = osl.SphereSweep(RIG, osl.SphereGrid(6, 4, num_spheres=20, min_depth=0.6))
    found = error_sums(index, gt_index, 20, find_regions(gt_index, sweep))
    np.testing.assert_allclose(
        sums_to_metrics([found["all"][key] for key in SUMS]), expected, atol=1e-12
    )
    assert found["at edges"]["rays"] == found["thin"]["rays"] == 0
    assert found["sky"]["rays"] == (24 if "sky" in name else 0)
    json.dumps(found, allow_nan=False)


# ---- regions


def relief(shape=(16, 40), num_spheres=64):
    """A ground plane with posts, boxes, one across the seam, sky, and unknown rays."""
    rng = np.random.default_rng(0)
    gt_index = np.tile(np.linspace(0, 12, shape[0])[:, None], shape[1])
    gt_index[:5] = 0
    for width in (1, 2, 3, 4, 5, 6, 9):
        row, column = rng.integers(shape[0] - 3), rng.integers(shape[1])
        columns = (column + np.arange(width)) % shape[1]
        gt_index[row : row + 8, columns] = rng.uniform(5, num_spheres + 2)
    gt_index[2:6, [-2, -1, 0, 1, 2]] = 40.7
    gt_index[rng.random(shape) < 0.02] = np.nan
    return gt_index


def test_edges_are_near_a_depth_discontinuity():
    gt_index, limit = relief(), 0.05 * 64
    H, W = gt_index.shape
    beside = set()
    for y, x in itertools.product(range(H), range(W)):
        for other in ((y, (x + 1) % W), (y + 1, x)):
            if other[0] < H and abs(gt_index[y, x] - gt_index[other]) > limit:
                beside |= {(y, x), other}
    expected = np.zeros((H, W), bool)
    for y, x in beside:
        for dy, dx in itertools.product(range(-3, 4), repeat=2):
            if 0 <= y + dy < H:
                expected[y + dy, (x + dx) % W] = True
    assert 0.1 < expected.mean() < 0.95
    np.testing.assert_array_equal(near_edges(gt_index, 64), expected)


@pytest.mark.parametrize(("width", "side"), [(40, 3), (600, 5)])
def test_thin_is_where_no_square_of_a_few_degrees_fits(width, side):
    gt_index = np.tile(relief(), (1, width // 40))
    H, W = gt_index.shape
    found = thin_objects(gt_index, 64)
    assert 0 < found.mean() < 0.5
    r = side // 2
    filled = np.where(np.isnan(gt_index), np.inf, gt_index)
    for y, x in np.random.default_rng(0).permutation(list(itertools.product(range(H), range(W))))[
        :160
    ]:
        lowest = []
        for cy, cx in itertools.product(range(y - r, y + r + 1), range(x - r, x + r + 1)):
            cy = min(max(cy, 0), H - 1)
            rows = np.arange(cy - r, cy + r + 1).clip(0, H - 1)
            lowest.append(filled[rows][:, np.arange(cx - r, cx + r + 1) % W].min())
        assert found[y, x] == (gt_index[y, x] - max(lowest) > 0.05 * 64)


def test_depth_ranges_and_cameras():
    grid = osl.SphereGrid(96, 24, num_spheres=12, min_depth=0.6)
    depth = np.random.default_rng(0).choice([np.inf, 5.0, 1.9, 1.7, 1.0, 0.8, 0.6], grid.shape)
    gt_index = grid.depth_to_index(depth)
    gt_index[3, 4] = np.nan
    regions = find_regions(gt_index, osl.SphereSweep(RIG, grid))
    known = np.isfinite(gt_index)
    for name, expected in {
        "all": True,
        "sky": np.isinf(depth),
        "far": (depth > 3 * 0.6) & np.isfinite(depth),
        "middle": (depth <= 3 * 0.6) & (depth > 1.5 * 0.6),
        "near": depth <= 1.5 * 0.6,
    }.items():
        np.testing.assert_array_equal(regions[name] & known, expected & known)
    center = np.mean([pose.t for pose in RIG.T_rig_cam], 0)
    points = center + grid.rays() * np.where(np.isinf(depth), 1e7, depth)[..., None]
    cameras = zip(RIG.cameras, RIG.T_rig_cam, strict=True)
    count = np.sum([camera.project(pose.inverse() @ points)[1] for camera, pose in cameras], 0)
    assert len(set(count[known])) >= 2
    for k in range(5):
        np.testing.assert_array_equal(regions[f"seen by {k}"] & known, (count == k) & known)
    assert np.sum([mask for name, mask in regions.items() if name.startswith("seen")], 0).min() == 1
    assert (regions["at edges"] ^ regions["off edges"]).all()


def test_hand_overs_are_where_the_view_of_a_camera_ends():
    """Four cameras of 220° in one place: views end 20° and 70° off each axis."""
    camera = RIG.cameras[0]
    poses = [osl.Pose.from_vector([0, yaw, 0, 0, 0, 0]) for yaw in np.radians([0, 90, 180, 270])]
    rig = osl.Rig([replace(camera, max_fov_deg=220.0)] * 4, poses)
    grid = osl.SphereGrid(720, 19, (-4.75, 4.75), 12, 0.6)
    gt_index = np.full(grid.shape, 3.0)
    gt_index[9, 100:110] = np.nan
    found = find_regions(gt_index, osl.SphereSweep(rig, grid))["at hand-overs"][9]
    ends = np.array([20, 70, 110, 160, 200, 250, 290, 340])
    azimuth = np.degrees(grid.thetas())[:, None]
    away = np.abs((azimuth - ends + 180) % 360 - 180).min(1)
    assert found[away < 2.5].all() and not found[away > 3.5].any()


def test_beside_a_plate_only_one_of_two_cameras_sees_the_sky():
    """x = ±0.5 m, a plate at z = 2 m, |x| < 1 m: θ from arctan(1/2) to arctan(3/4)."""
    rig = osl.Rig([RIG.cameras[0]] * 2, [osl.Pose(np.eye(3), [x, 0, 0]) for x in (-0.5, 0.5)])
    grid = osl.SphereGrid(720, 20, (-45, 45), 32, 1.5)
    x, _, z = np.moveaxis(grid.rays(), -1, 0)
    azimuth = np.abs(np.degrees(np.arctan2(x, z)))
    gt_index = grid.inverse_depth_to_index(np.where((z > 0) & (np.abs(x) < z / 2), z / 2, 0.0))
    found = find_regions(gt_index, osl.SphereSweep(rig, grid))["occluded"]
    # above and below, lines of sight leave the panorama
    found, azimuth = found[5:15], azimuth[5:15]
    low, high = np.degrees(np.arctan([0.5, 0.75]))
    np.testing.assert_array_equal(found[azimuth < low - 0.5], False)
    # the rest grazes it
    np.testing.assert_array_equal(found[(azimuth > low + 0.5) & (azimuth < high - 2.5)], True)
    np.testing.assert_array_equal(found[(azimuth > high + 1) & (azimuth < 90)], False)


# ---- bootstrap


def mean(x):
    return x


def test_bootstrap_of_two_frames_by_hand():
    """The mean is a, (a + b)/2 or b with chances 1/4, 1/2, 1/4."""
    assert bootstrap([[3.0], [5.0]], mean).tolist() == [[4.0, 3.0, 5.0]]


def test_bootstrap_of_four_frames_against_all_resamples():
    values = np.array([1.0, 2.0, 4.0, 9.0])
    means = [np.mean(drawn) for drawn in itertools.product(values, repeat=4)]
    expected = [4.0, *np.percentile(means, [2.5, 97.5])]
    # the steps between means
    np.testing.assert_allclose(bootstrap(values[:, None], mean)[0], expected, atol=0.26)


def test_bootstrap_is_open_for_one_frame():
    values = np.random.default_rng(0).normal(size=(1, 5))
    one = bootstrap(values, mean)
    np.testing.assert_array_equal(one[:, 0], values[0])
    assert np.isnan(one[:, 1:]).all()


# ---- tables


def record(figures_of, sets=("box", "sunset", "sunny")):
    """Results with these metrics for every method, set and frame, out of order."""
    methods = [
        EvaluatedMethod.parse(text) for text in ("zncc+sgm", "zncc,window=5", "mccnn", "zncc")
    ]
    empty = dict.fromkeys(SUMS, 0)

    def errors(name, k, method):
        regions = {
            "all": dict(zip(SUMS, (100, 50, 20, 10 + k, 150.0, 900.0), strict=True)),
            "thin": dict(zip(SUMS, (10 * k, 5 * k, 0, 0, 40.0 * k, 160.0 * k), strict=True)),
            "sky": dict(zip(SUMS, (20, 10, 8, 8, 70.0, 500.0), strict=True)),
            **dict.fromkeys(
                ("far", "middle", "near", "at edges", "off edges", "at hand-overs", "seen by 0"),
                empty,
            ),
        }
        figures = dict(zip(METRICS, figures_of(name, k, method), strict=True))
        return {"figures": figures, "strata": regions}

    frames = {
        name: {f"{k:05}": {m.name: errors(name, k, m.name) for m in methods} for k in (1, 2, 3)}
        for name in sets
    }
    config = {"width": 320, "height": 80, "num_spheres": 64, "rig": "own"}
    return {"config": config, "methods": {m.name: vars(m) for m in methods}, "frames": frames}


LABELS = ["ZNCC", "ZNCC, window = 5", "MC-CNN", "ZNCC + SGM"]


def test_the_table_has_the_form_of_the_paper():
    table = errors_table(
        record(lambda name, k, method: [10.0 * k, 5.0 * k, k, len(name) + k / 8, 0.5 * k])
    )
    assert table.columns[:5] == ["Sunny >1", "Sunny >3", "Sunny >5", "Sunny MAE", "Sunny RMS"]
    assert [column.split()[0] for column in table.columns[::5]] == ["Sunny", "Sunset", "Box"]
    assert [words[0] for words, _ in table.rows] == LABELS
    cells = table.rows[0][1]
    np.testing.assert_allclose(cells[:5, 0], [20, 10, 2, 5.25, 1])
    assert (cells[:, 1] < cells[:, 0]).all() and (cells[:, 0] < cells[:, 2]).all()
    lines = table.text().splitlines()
    assert table.caption == lines.pop() == table.markdown().splitlines()[-1]
    assert table.caption.startswith(
        "Means over frames (3 of sunny, 3 of sunset, 3 of box), in % of the N spheres"
    )
    assert (
        "320 × 80, N = 64, pairs = ring, window = 5, p1 = 0.052, p2 = 2.6, whole indices, unless"
        in table.caption
    )
    assert len(lines) == 1 + 2 * 4
    assert lines[1].split()[:6] == ["ZNCC", "20.0", "10.0", "2.0", "5.25", "1.00"]
    interval = f"{cells[0, 1]:.1f}–{cells[0, 2]:.1f}"
    assert lines[2].split()[0] == interval
    words = ("Sunny >1", "20.0", interval)
    # aligned
    pairs = zip(lines[:3], words, strict=True)
    assert len({line.index(word) + len(word) for line, word in pairs}) == 1
    rows = [line.strip("| ").split(" | ") for line in table.markdown().splitlines()[:-2]]
    assert {len(row) for row in rows} == {16}
    assert rows[0][1] == "Sunny &gt;1"
    assert rows[1][:2] == ["---", "---:"]
    assert rows[2][1] == f"20.0<br><sub>{interval}</sub>"
    head, *rows = csv.reader(io.StringIO(table.csv()))
    assert head[:4] == ["method", "Sunny >1", "Sunny >1 low", "Sunny >1 high"] and len(head) == 46
    np.testing.assert_allclose([float(x) for x in rows[0][1:]], cells.ravel(), rtol=1e-5)


def test_frames_that_cannot_be_evaluated_are_left_out_of_the_mean():
    def some(name, k, method):
        return [None] * 5 if (k == 2 or name == "box") else [float(k)] * 5

    table = errors_table(record(some))
    cells = table.rows[0][1]
    np.testing.assert_allclose(cells[:10, 0], 2.0)
    assert np.isnan(cells[10:]).all()
    assert table.text().splitlines()[1].split()[-5:] == ["–"] * 5
    assert "nan" not in table.markdown() + table.csv()


def test_regions_pool_all_rays():
    table = regions_table(record(lambda *_: [1.0] * 5, sets=("sunny",)))
    shares = {"all": "100.0 %", "without sky": "80.0 %", "sky": "20.0 %", "thin": "20.0 %"}
    assert [row[:3] for row, _ in table.rows[::4]] == [["sunny", *item] for item in shares.items()]
    assert [words[3] for words, _ in table.rows[:4]] == LABELS
    np.testing.assert_allclose(table.rows[0][1][:, 0], [50, 20, 12, 1.5, 3])
    np.testing.assert_allclose(table.rows[0][1][2], [12, 11, 13], atol=0.34)
    np.testing.assert_allclose(table.rows[4][1][:, 0], [50, 15, 5, 1, np.sqrt(5)])
    # in every frame
    np.testing.assert_allclose(table.rows[12][1], [[50] * 3, [0] * 3, [0] * 3, [4] * 3, [4] * 3])


def test_a_table_of_one_frame_has_no_intervals():
    table = Table(["method"], ["MAE"], [(["ZNCC"], np.array([[1.5, np.nan, np.nan]]))])
    assert table.text() == "method   MAE\nZNCC    1.50\n"
    assert table.markdown().splitlines()[-1] == "| ZNCC | 1.50 |"
    assert table.csv() == "method,MAE,MAE low,MAE high\nZNCC,1.5,,\n"


# ---- records


nested = st.recursive(
    st.text(" {}\n\\,:a")
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.none(),
    lambda inner: st.dictionaries(st.text(" {}\n\\,:a"), inner, max_size=3),
)


@given(nested)
def test_a_record_comes_back(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "record.json"
    record = {name: {} for name in ("config", "methods", "data", "weights")} | {"frames": content}
    write_record(path, record)
    assert read_data(path) == record
