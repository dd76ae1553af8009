"""Rigs measured from images: closed-form points, then frames rendered with known poses."""

import numpy as np
import pytest
import scene
from scene import refused

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.images.features import Features, Tracks, join_tracks
from omnistereo_rigs.images.from_images import (
    MeasuredRig,
    _covariance,
    _with_prior,
    chain_poses,
    find_features,
    measure_rig,
    relative_poses,
)
from omnistereo_rigs.images.relative_pose import decompositions, depths, eight_point, relative_pose
from omnistereo_rigs.images.track_bundle import TrackBundle, moved_rig, pose_differences
from omnistereo_tools.commands import calibrate_images
from omnistereo_tools.commands.calibrate_command import CalibrateOptions

RIG = scene.rig(width=400, height=384)


def turned(rig, degrees, seed=0, share=0.0):
    """The rig with each camera rotated about some axis, and shifted by a share of the radius."""
    rng = np.random.default_rng(seed)
    axes, shifts = (
        x / np.linalg.norm(x, axis=1, keepdims=True) for x in rng.normal(size=(2, len(rig), 3))
    )
    radius = np.linalg.norm(rig.centers - rig.centers.mean(0), axis=1).mean()
    return moved_rig(
        rig, np.concatenate([np.radians(degrees) * axes, share * radius * shifts], axis=1)
    )


def synthetic_tracks(rig, count=700, noise=0.0, seed=0, nearest=1.0, farthest=20.0):
    """Points all around, projected by the cameras: pixels with noise, and who sees them."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(count, 3))
    points = (
        u
        / np.linalg.norm(u, axis=1, keepdims=True)
        / rng.uniform(1 / farthest, 1 / nearest, (count, 1))
    )
    parts = []
    for k, (camera, pose) in enumerate(zip(rig.cameras, rig.T_rig_cam, strict=True)):
        uv, valid = camera.project(pose.inverse() @ points)
        seen = np.flatnonzero(valid)
        off = rng.normal(0, noise, (len(seen), 2)) if noise else 0
        parts.append((np.full(len(seen), k), seen, uv[seen] + off))
    camera, point, pixels = (np.concatenate(column) for column in zip(*parts, strict=True))
    tracks = Tracks(camera, np.zeros(len(camera), int), point, pixels)
    return tracks.select(np.ones(len(camera), bool))


def solved(rig, tracks, scales=(20.0, 5.0, 2.5), **settings):
    bundle = TrackBundle(rig, tracks, **settings)
    for scale in scales:
        bundle.solve(scale, 12)
    return bundle


def errors(rig, true):
    """Largest error of a rotation in degrees, and of a centre in metres."""
    off = pose_differences(rig, true)
    return np.degrees(np.linalg.norm(off[:, :3], axis=1)).max(), np.linalg.norm(
        off[:, 3:], axis=1
    ).max()


@pytest.fixture(scope="module")
def rays():
    """A pose, and rays of points on all sides, also behind both cameras."""
    rng = np.random.default_rng(3)
    T_b_a = osl.Pose.from_vector([0.3, 2.0, -0.4, 0.6, 0.1, -0.3])
    x = rng.normal(size=(300, 3)) * 4
    y = T_b_a @ x
    return T_b_a, *(a / np.linalg.norm(a, axis=1, keepdims=True) for a in (x, y))


def test_eight_points_on_rays_on_all_sides(rays):
    T, x, y = rays
    E = eight_point(x, y)
    expected = cross(T.t[None])[0] @ T.R
    expected /= np.linalg.norm(expected) / np.sqrt(2)
    np.testing.assert_allclose(E * np.sign((E * expected).sum()), expected, atol=1e-9)
    right = [pose for pose in decompositions(E) if all((d > 0).all() for d in depths(pose, x, y))]
    assert len(right) == 1
    np.testing.assert_allclose(right[0].R, T.R, atol=1e-9)
    np.testing.assert_allclose(right[0].t, T.t / np.linalg.norm(T.t), atol=1e-9)


def test_a_relative_pose_among_wrong_matches(rays):
    T, x, y = rays
    y = y.copy()
    y[:120] = y[:120][::-1]  # two in five
    found = relative_pose(x, y, np.zeros(len(x)))
    assert found.believable and 170 <= found.inliers <= 190
    assert (found.T_b_a @ T.inverse()).magnitude()[0] < 0.01
    assert found.T_b_a.t @ T.t / np.linalg.norm(T.t) > 1 - 1e-6
    unrelated = relative_pose(x, y[np.random.default_rng(0).permutation(len(y))], np.zeros(len(x)))
    assert not unrelated.believable
    assert relative_pose(x[:19], y[:19], np.zeros(19)) is None


def test_poses_are_chained_from_pairs():
    pairs = relative_poses(RIG)
    T = RIG.T_rig_cam[2].inverse() @ RIG.T_rig_cam[0]
    np.testing.assert_allclose(pairs[0, 2].T_b_a.t, T.t / np.linalg.norm(T.t))
    turn, shift = errors(RIG.with_poses(chain_poses(pairs, 4)), RIG)
    assert turn < 1e-6 and shift < 0.02  # lengths that are equal are preferred a little
    with refused("too few matches connect camera 4 to camera 1"):
        chain_poses({key: found for key, found in pairs.items() if 3 not in key}, 4)


def test_tracks_with_two_features_of_one_camera_are_dropped():
    forward = np.tile([0.0, 0.0, 1.0], (3, 1))
    features = [Features(forward, np.zeros((3, 128), np.float32))] * 3
    matches = {
        (0, 1): np.array([[0, 0], [1, 1], [2, 2]]),
        (1, 2): np.array([[0, 0], [1, 1]]),
        (0, 2): np.array([[0, 1]]),
    }
    tracks = join_tracks(RIG.cameras[:3], [features], [matches])
    assert tracks.num_points == 1 and tracks.camera.tolist() == [0, 1]


def test_the_rig_of_exact_points_is_found():
    bundle = solved(turned(RIG, 2.0, share=0.03), synthetic_tracks(RIG))
    turn, shift = errors(bundle.adjusted_rig(), RIG)
    assert turn < 1e-4 and shift < 1e-5


def test_centre_and_focal_length_of_a_lens_are_found():
    """Tracks of true lenses, started at lenses of another centre and focal length."""
    given = [
        scene.camera(400, 384, 220 * (1.0 + 0.005 * (-1) ** k), (k + 1.5, -k)) for k in range(4)
    ]
    start = osl.Rig(given, RIG.T_rig_cam)
    bundle = solved(start, synthetic_tracks(RIG), free_lenses=True)
    covariance, lens_px = _covariance(bundle)
    assert covariance.shape == (24, 24) and np.isfinite(covariance).all() and lens_px == 0
    found = bundle.adjusted_rig()
    for camera, true in zip(found.cameras, RIG.cameras, strict=True):
        assert np.abs(np.subtract(camera.center, true.center)).max() < 0.3
        assert camera.inv_poly[1] == pytest.approx(true.inv_poly[1], rel=1e-3)


def test_deviations_are_honest():
    chi2 = []
    for seed in range(8):
        bundle = solved(RIG, synthetic_tracks(RIG, 500, 0.2, seed), (2.5,))
        bundle.rescale()
        bundle.solve(2.5, 8)
        assert bundle.sigma_px == pytest.approx(0.2, rel=0.15)
        C, off = bundle.covariance(), pose_differences(bundle.adjusted_rig(), RIG).ravel()
        values, vectors = np.linalg.eigh(C)
        chi2.append(((vectors[:, 7:].T @ off) ** 2 / values[7:]).sum() / 17)
    assert 0.5 < np.mean(chi2) < 2


def test_the_error_of_a_lens_raises_the_deviations():
    """What halves of the sphere disagree about is no noise."""
    tracks = synthetic_tracks(RIG, 700, 0.1)
    found = []
    for shift in (0.0, 2.0):
        wrong = osl.Rig(
            [scene.camera(400, 384, shift=(k + shift, -k)) for k in range(4)], RIG.T_rig_cam
        )
        bundle = solved(wrong, tracks)
        bundle.rescale()
        bundle.solve(2.5, 8)
        covariance, lens_px = _covariance(bundle)
        found.append(lens_px)
    assert found[0] < 0.2 and found[1] > 0.7
    deviations = np.sqrt(np.diag(covariance).reshape(4, 2, 3).sum(2))
    off = np.linalg.norm(pose_differences(bundle.adjusted_rig(), RIG).reshape(4, 2, 3), axis=2)
    assert 0.2 < (off / deviations).mean() < 2


def test_far_points_do_not_show_the_centres():
    bundle = solved(RIG, synthetic_tracks(RIG, 500, 0.3, nearest=200.0, farthest=400.0), (2.5,))
    bundle.rescale()
    covariance, factor = _covariance(bundle)
    measured = MeasuredRig(
        RIG, np.zeros((4, 6)), covariance, bundle.points, 100, bundle.sigma_px, factor
    )
    (refusal,) = measured.refusals()
    assert "is known to ±" in refusal and "nine tenths of the points are beyond" in refusal


def test_few_points_are_refused_with_their_number():
    bundle = solved(RIG, synthetic_tracks(RIG, 200, 0.1), (2.5,))
    covariance = bundle.covariance()
    measured = MeasuredRig(
        RIG, np.zeros((4, 6)), covariance, bundle.points, 40, bundle.sigma_px, 1.0
    )
    said = f"{bundle.tracks.num_points} points in 40 cells of 15° are too few"
    assert said in measured.refusals()[0]


@pytest.fixture(scope="module")
def street():
    """Two frames of half the size, and their features."""
    data = osl.load_dataset(DATA / "sunny", split="train")
    images = [data[k].images for k in (0, 30)]
    return data.rig, images, find_features(data.rig.cameras, images)


def test_a_rendered_rig_is_measured_from_poses_that_are_2_degrees_off(street):
    true, images, features = street
    measured = measure_rig(turned(true, 2.0, 4, 0.03), images, "nominal", features)
    turn, shift = errors(measured.rig, true)
    # 0.05 degrees are a sixth of a pixel of these images; centres to 1 %
    assert turn < 0.06 and shift < 0.006
    turn_sd, shift_sd = measured.deviations.max(axis=0)
    assert 0.1 < turn / turn_sd < 2.5 and 0.1 < shift / shift_sd < 2.5


def test_a_calibration_keeps_weight():
    """In one dimension the mean of two values, each weighted by its variance."""
    measured, prior = np.radians(0.3) ** 2, np.radians(0.15) ** 2
    kept, covariance = _with_prior(np.full((2, 6), 0.01), measured * np.eye(12))
    np.testing.assert_allclose(kept[:, :3], 0.01 * prior / (prior + measured))
    np.testing.assert_allclose(np.diag(covariance)[:3], measured * prior / (measured + prior))
    assert kept[0, 3] == 0.01  # the centres have their prior in the adjustment


def test_images_without_texture_are_refused_with_the_number_of_matches():
    with refused("the images have 0 matches between their cameras"):
        measure_rig(RIG, [[np.full((384, 400), 90, np.uint8)] * 4])


@pytest.mark.parametrize(("degrees", "word"), [(0.01, "Good"), (0.2, "Fair"), (2.0, "Bad")])
def test_why_a_given_calibration_stays_is_a_verdict(monkeypatch, capsys, tmp_path, degrees, word):
    differences = np.zeros((4, 6))
    differences[1, 0] = np.radians(degrees)
    points = np.column_stack([np.tile([0.0, 0.0, 1.0], (400, 1)), np.linspace(0.1, 1.0, 400)])
    found = MeasuredRig(RIG, differences, 1e-7 * np.eye(24), points, 100, 0.1, 0.05)
    images = [[np.zeros((384, 400), np.uint8)] * 4]
    monkeypatch.setattr(calibrate_images, "_read", lambda *_: (images, RIG, "calibration"))
    monkeypatch.setattr(calibrate_images, "find_mixup", lambda _: None)
    monkeypatch.setattr(calibrate_images, "_measure", lambda *_: (found, "no better", []))
    pictures = tuple(tmp_path / f"{k}.png" for k in range(4))
    options = CalibrateOptions(
        from_images=pictures, rig=tmp_path / "rig.yaml", calibrated=True, out=tmp_path / "out"
    )
    assert calibrate_images.run(options) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"{word}: the given rig stays, nothing is written: no better.\n")
    assert not (tmp_path / "out").exists()
