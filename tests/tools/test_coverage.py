"""Coverage of a rig against closed forms: solid angles, triangulation, spheres a pixel apart."""

from itertools import combinations

import numpy as np
import pytest
import scene
from scene import refused

import omnistereo_lib as osl
from omnistereo_tools.judge.coverage import Coverage


def rig_of(*poses, fov=200.0):
    return osl.Rig(
        [scene.camera(400, 384, fov)] * len(poses), [osl.Pose.from_vector(pose) for pose in poses]
    )


def test_shares_of_back_to_back_cameras_are_solid_angles():
    coverage = Coverage.of(rig_of([0, 0, 0, 0, 0, 0.1], [0, np.pi, 0, 0, 0, -0.1]))
    cone = (1 - np.cos(np.radians(100))) / 2  # of the sphere
    assert coverage.share(1) == pytest.approx(1)
    assert coverage.share(2) == pytest.approx(2 * cone - 1, abs=0.01)
    assert coverage.share(3) == 0


def test_baseline_across_the_ray_and_resolution_by_triangulation():
    """0.2 m apart along x: rotate the left ray by a pixel, see where it meets the right one."""
    coverage = Coverage.of(rig_of([0, 0, 0, -0.1, 0, 0], [0, 0, 0, 0.1, 0, 0]))
    rays = coverage.grid.rays()
    two = coverage.cameras == 2
    np.testing.assert_allclose(
        coverage.baseline[two], 0.2 * np.linalg.norm(rays[two][:, 1:], axis=1)
    )
    assert np.isnan(coverage.baseline[~two]).all()
    assert two.mean() == pytest.approx(200 / 360, abs=0.1)
    f = (384 / 2 - 2) / np.radians(100)  # px per radian of the equidistant lens
    assert coverage.pixels_per_degree == pytest.approx(np.radians(f), rel=1e-3)
    row, column = 90, 200  # 20.5° right, 0.5° down
    depth, step = 3.0, 0.01 / f  # a hundredth of a pixel, so that the first order counts
    point = depth * rays[row, column]
    left, right = point - [-0.1, 0, 0], point - [0.1, 0, 0]
    # from the plane across the baseline
    angles = [np.arctan2(v[0], np.hypot(v[1], v[2])) for v in (left, right)]
    reach = 0.2 / (np.tan(angles[0] + step) - np.tan(angles[1]))
    x = -0.1 + reach * np.tan(angles[0] + step)
    off = depth - np.hypot(x, reach)
    assert coverage.depth_resolution(depth)[row, column] == pytest.approx(100 * off, rel=0.02)


def test_the_proposed_spheres_move_a_match_by_about_a_pixel():
    data = osl.load_dataset("data_samples/sunny", split="test")
    coverage = Coverage.of(data.rig)
    grid = coverage.propose()
    assert grid.min_depth == pytest.approx(data.rig.min_depth, rel=0.2)  # which the sets state
    rays, moved = grid.rays()[::37, ::37].reshape(-1, 3), []
    near, far = (
        [grid.index_to_depth(n) * rays - center for center in coverage.rig.centers]
        for n in (70, 69)
    )
    cameras = zip(coverage.rig.cameras, coverage.rig.T_rig_cam, far, strict=True)
    seen = [camera.project(points @ pose.R)[1] for camera, pose, points in cameras]
    for i, j in combinations(range(4), 2):
        parallax = [angle(a[i], a[j]) for a in (near, far)]
        moved.append(np.where(seen[i] & seen[j], np.abs(parallax[0] - parallax[1]), 0))
    pixels = np.degrees(np.max(moved, 0)) * coverage.pixels_per_degree
    assert 0.7 < np.median(pixels) < 1.2
    assert grid.width == pytest.approx(360 * coverage.pixels_per_degree, abs=4)


def angle(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def test_depth_is_good_from_where_the_views_of_a_point_are_30_degrees_apart():
    """A pair b apart sees the point straight ahead at d from directions 2 atan(b / 2d) apart."""
    coverage = Coverage.of(rig_of([0, 0, 0, -0.1, 0, 0], [0, 0, 0, 0.1, 0, 0]))
    good = coverage.good_from
    assert good[14:16, 29:31] == pytest.approx(0.1 / np.tan(np.radians(15)), rel=0.06)
    assert np.isinf(good[14:16, :8]).all()  # behind both
    assert coverage.nearest < np.median(good[np.isfinite(good)])
    far = Coverage.of(rig_of([0, 0, 0, -1.0, 0, 0], [0, 0, 0, 1.0, 0, 0]))
    np.testing.assert_allclose(far.good_from, 10 * good)  # depth scales with the rig
    assert far.nearest == pytest.approx(10 * coverage.nearest, rel=0.05)
    assert "Depth can be measured ahead from 0.3" in " ".join(coverage.sentences())


def test_cameras_at_one_place_are_told():
    coverage = Coverage.of(rig_of([0] * 6, [0, 1, 0, 0, 0, 0]))
    with refused("all cameras are at one place: they see no depth"):
        coverage.propose()


def test_a_forward_pair_has_no_row_with_depth_all_around():
    coverage = Coverage.of(rig_of([0, 0, 0, -0.1, 0, 0], [0, 0, 0, 0.1, 0, 0], fov=120.0))
    assert coverage.rows() is None and coverage.propose(640).phi_deg == (-45, 45)
    assert coverage.sentences()[-1].startswith("No row of the panorama has depth all around")


def test_cameras_that_share_no_view_have_no_depth():
    coverage = Coverage.of(rig_of([0, 0, 0, 0, 0, 0.1], [0, np.pi, 0, 0, 0, -0.1], fov=120.0))
    assert coverage.share(1) == pytest.approx(0.5, abs=0.01) and coverage.share(2) == 0
    assert coverage.sentences()[1:] == ["No two cameras see the same direction: there is no depth."]
