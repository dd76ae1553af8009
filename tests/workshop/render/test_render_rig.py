"""The rendered rigs without Blender: lens, poses, sensor."""

import warnings

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from lens_oracle import blender_pixel, directions

import omnistereo_lib as osl
from workshop.render.camera.lens import fit_ocam, random_lens
from workshop.render.camera.render_rig import Sensor, _yaml_float, make_rig, write_config
from workshop.render.camera.sensor import _tone, develop
from workshop.render.image_sets import SEED


@given(st.integers(0, 2**32), st.floats(0, np.radians(113)))
@settings(deadline=None)
def test_lens_radius_is_the_inverse_of_theta(seed, theta):
    lens = random_lens(np.random.default_rng(seed))
    assert lens.theta(lens.radius(theta)) == pytest.approx(theta, abs=1e-12)


@given(st.integers(0, 2**32))
@settings(max_examples=5, deadline=None)
def test_ocam_polynomials_fit_the_lens(seed):
    lens = random_lens(np.random.default_rng(seed))
    for width in (800, 400):
        fit = fit_ocam(lens, width)
        assert max(fit.residual_px, fit.inverse_residual_px) < 2e-3
        camera = osl.OcamCamera(
            fit.poly, fit.inv_poly, fit.center, (1, 0, 0), (width, width * 96 // 100)
        )
        assert camera.inverse_poly_error_px() < 5e-3


@pytest.mark.parametrize(("name", "size"), [("van", (800, 768)), ("handheld", (400, 384))])
def test_written_rig_sees_what_blender_draws(name, size, tmp_path):
    rig = make_rig(SEED, name)
    write_config(tmp_path / "config.yaml", rig, size, {"img_fmt": "cam%d/%04d.jpg", "start": 1})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = osl.load_rig(tmp_path)
    assert loaded.min_depth == rig.min_depth
    for camera, pose, made in zip(loaded.cameras, loaded.T_rig_cam, rig.cameras, strict=True):
        assert camera.image_size == size and camera.max_fov_deg == 220
        np.testing.assert_allclose(pose.R, made.T_rig_cam.R, atol=1e-12)
        np.testing.assert_array_equal(pose.t, made.T_rig_cam.t)
        rays = directions(110)
        uv, valid = camera.project(rays)
        expected = blender_pixel(made.lens, rays, size)
        assert np.abs(uv - expected).max() < 0.01
        np.testing.assert_array_equal(valid, camera.contains(expected))
        assert valid.mean() > 0.95


def test_config_names_each_camera_and_says_what_only_a_rendered_rig_knows(tmp_path):
    rig = make_rig(SEED)
    write_config(
        tmp_path / "config.yaml", rig, (800, 768), {"img_fmt": "cam%d/%04d.jpg", "start": 701}
    )
    content = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert content["dataset"] == {"img_fmt": "cam%d/%04d.jpg", "start": 701}
    for number, (entry, camera) in enumerate(zip(content["cameras"], rig.cameras, strict=True), 1):
        assert entry["cam_id"] == number and entry["img_dir"] == f"cam{number}"
        known = {"exposure_gain": camera.sensor.gain, "falloff": camera.sensor.falloff}
        for key, value in known.items():
            assert entry[key] == pytest.approx(value, abs=1e-6)
        assert entry["fit_residual_px"] < 2e-3


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(deadline=None)
def test_numbers_survive_yaml(value):
    assert yaml.safe_load(_yaml_float(value)) == value
    assert isinstance(yaml.safe_load(_yaml_float(value)), float)


# The rig and the sensor


@pytest.mark.parametrize(("name", "baseline"), [("van", 0.6), ("handheld", 0.15 * np.sqrt(2))])
def test_rig_stands_around_its_center(name, baseline):
    rig = make_rig(SEED, name)
    centers = np.stack([camera.T_rig_cam.t for camera in rig.cameras])
    np.testing.assert_allclose(centers.mean(0), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(centers, axis=1), baseline, rtol=0.05)
    for camera, forward in zip(
        rig.cameras, np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]]), strict=True
    ):
        assert camera.T_rig_cam.R[:, 2] @ forward > np.cos(np.radians(4))
        assert camera.T_rig_cam.t @ forward > 0.9 * baseline


def test_rig_comes_from_its_seed_alone():
    def numbers(rig):
        cameras = (
            (*c.T_rig_cam.as_vector(), *c.lens.k, *c.lens.center, *vars(c.sensor).values())
            for c in rig.cameras
        )
        return np.array(list(cameras))

    np.testing.assert_array_equal(numbers(make_rig(7)), numbers(make_rig(7)))
    assert (numbers(make_rig(7)) != numbers(make_rig(8))).all()
    # no two cameras share anything
    assert len(np.unique(numbers(make_rig(7)))) == numbers(make_rig(7)).size


QUIET = Sensor(gain=1.0, read_noise=0.0, shot_noise=0.0, falloff=0.15)
LENS = make_rig(SEED).cameras[0].lens


def light(picture):
    """Linear signal of pixel values: the tone curve, read backwards."""
    signal = np.linspace(0, 4, 200_001)
    return np.interp(picture / 255.0, _tone(signal), signal)


def test_developed_picture_is_dark_at_the_rim():
    picture = develop(
        np.full((768, 800, 3), 0.3), LENS, QUIET, 1.0, False, np.random.default_rng(0)
    )
    assert picture.shape == (768, 800, 3) and picture.dtype == np.uint8
    u, v = np.rint(LENS.center).astype(int)
    rim = int(u - LENS.radius(np.radians(110)))
    assert light(picture[v, u]) == pytest.approx([0.3] * 3, rel=0.01)
    assert light(picture[v, rim]) == pytest.approx([0.3 * 0.85] * 3, rel=0.01)


def test_developed_noise_is_that_of_the_sensor():
    sensor = Sensor(gain=0.9, read_noise=0.02, shot_noise=2e-3, falloff=0.0)
    picture = develop(
        np.full((384, 400, 3), 0.25), LENS, sensor, 1.1, True, np.random.default_rng(0)
    )
    assert picture.shape == (384, 400)
    signal = 0.25 * 1.1 * 0.9
    assert light(picture).mean() == pytest.approx(signal, rel=0.01)
    assert light(picture).std() == pytest.approx(np.sqrt(0.02**2 + 2e-3 * signal), rel=0.02)


@given(st.floats(0, 1e6), st.booleans())
@settings(deadline=None)
def test_developing_takes_any_light_and_repeats(radiance, gray):
    field = np.full((24, 25, 3), radiance) * np.linspace(0, 1, 25)[:, None]
    first, second = (
        develop(field, LENS, QUIET, 1.0, gray, np.random.default_rng(3)) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)
    assert (np.diff(first.astype(int)[:, :12], axis=1) >= 0).all()  # more light, more signal


def test_gray_is_the_luminance():
    red, white = np.zeros((24, 25, 3)), np.full((24, 25, 3), 0.2126)
    red[..., 0] = 1.0
    pictures = [
        develop(field, LENS, QUIET, 1.0, True, np.random.default_rng(0)).astype(int)
        for field in (red, white)
    ]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
