"""Other camera models against formulas written out for one ray, against OpenCV, and as OCam
cameras."""

from functools import partial
from math import acos, asin, degrees, hypot, sqrt

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnistereo_lib import OmnistereoError
from omnistereo_rigs.formats.camera_models import (
    double_sphere,
    kannala_brandt,
    make_camera_model,
    omni,
    unified,
)
from omnistereo_rigs.formats.fit import fit_ocam

SIZE = (1216, 1200)
PINHOLE = {"fx": 225.0, "fy": 222.5, "cx": 610.8, "cy": 600.2}
KB4 = PINHOLE | {"fx": 320.0, "fy": 321.0, "k1": -0.011, "k2": 0.004, "k3": -0.0021, "k4": 0.0003}
DOUBLE_SPHERE = PINHOLE | {"xi": -0.28, "alpha": 0.57}


def rays(theta_deg, azimuths=16):
    theta, azimuth = np.meshgrid(
        np.radians(theta_deg), np.arange(azimuths) * 2 * np.pi / azimuths, indexing="ij"
    )
    return np.stack(
        [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], -1
    )


points = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 3)).filter(
    lambda p: hypot(*p) > 0.1
)


@given(points)
def test_unified_models_by_hand(point):
    x, y, z = point
    uv, valid = unified(np.array(point), **PINHOLE, alpha=0.6, beta=1.1)
    if valid:
        depth = 0.6 * sqrt(1.1 * (x * x + y * y) + z * z) + 0.4 * z
        np.testing.assert_allclose(uv, [225.0 * x / depth + 610.8, 222.5 * y / depth + 600.2])
    # Mei's sphere with xi = alpha / (1 - alpha) is the unified model with focal lengths divided by
    # 1 - alpha.
    mei = PINHOLE | {"fx": 225.0 / 0.4, "fy": 222.5 / 0.4}
    uv, valid = unified(np.array(point), **PINHOLE, alpha=0.6)
    other, valid_too = omni(np.array(point), **mei, xi=1.5)
    assert valid == valid_too
    if valid:
        np.testing.assert_allclose(other, uv, atol=1e-8)


def test_omni_distortion_is_opencvs():
    """The pinhole camera of OpenCV has the same distortion, on the plane that the sphere is seen
    on."""
    at = rays(np.arange(1, 60, 7))
    distortion = {"k1": 0.01, "k2": -0.002, "p1": 0.003, "p2": -0.001}
    ours, valid = omni(at, **PINHOLE, xi=1.5, **distortion)
    moved = at.reshape(-1, 3) + np.array([0, 0, 1.5])
    K = np.array([[225.0, 0, 610.8], [0, 222.5, 600.2], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(
        moved, np.zeros(3), np.zeros(3), K, np.array(list(distortion.values()))
    )
    assert valid.all()
    np.testing.assert_allclose(ours.reshape(-1, 2), theirs.reshape(-1, 2), atol=1e-6)


def test_each_model_says_where_it_ends():
    w1 = (1 - 0.57) / 0.57
    w2 = (w1 - 0.28) / sqrt(1 - 2 * w1 * 0.28 + 0.28**2)
    ends = {
        90 + degrees(asin(w2)): partial(double_sphere, **DOUBLE_SPHERE),
        90 + degrees(asin(0.4 / 0.6)): partial(unified, **PINHOLE, alpha=0.6),
        degrees(acos(-0.8)): partial(omni, **PINHOLE, xi=0.8),
        # r' = 1 - θ²
        degrees(1.0): partial(kannala_brandt, **PINHOLE, k1=-1 / 3, k2=0, k3=0, k4=0),
    }
    for end, project in ends.items():
        assert project(rays([end - 0.01]))[1].all() and not project(rays([end + 0.01]))[1].any()
    assert not kannala_brandt(np.zeros(3), **KB4)[1]


@pytest.mark.parametrize(
    "project",
    [
        partial(double_sphere, **DOUBLE_SPHERE),
        partial(kannala_brandt, **KB4),
        partial(unified, **PINHOLE, alpha=0.6, beta=1.05),
        partial(omni, **(PINHOLE | {"fx": 560.0, "fy": 556.0}), xi=1.5, k1=-0.01, k2=0.002),
    ],
)
def test_radial_models_become_ocam_cameras(project):
    camera, residual = fit_ocam(project, SIZE)
    assert residual < 0.02 and camera.max_fov_deg > 200
    # not where it was fitted
    at = rays(np.linspace(0.05, camera.max_fov_deg / 2 - 0.05, 311), azimuths=37)
    theirs, _ = project(at)
    for exact in (False, True):
        ours, valid = camera.project(at, use_direct_poly=exact)
        assert valid.mean() > 0.9
        assert np.abs(ours - theirs).max() < 0.02
    assert camera.affine[0] == pytest.approx(
        project.keywords["fy"] / project.keywords["fx"], abs=1e-9
    )
    np.testing.assert_allclose(camera.center, (610.8, 600.2), atol=1e-6)
    assert camera.inverse_poly_error_px() < 0.05


def test_tangential_distortion_shows_in_the_residual():
    lens = PINHOLE | {"fx": 560.0, "fy": 556.0}
    residuals = [
        fit_ocam(partial(omni, **lens, xi=1.5, p1=p1), SIZE)[1] for p1 in (0.0, 1e-4, 1e-3)
    ]
    assert residuals[0] < 0.02 < residuals[1] < residuals[2]
    camera, residual = fit_ocam(partial(omni, **lens, xi=1.5, p1=1e-3), SIZE)
    at = rays(np.linspace(0.1, camera.max_fov_deg / 2, 200))
    worst = np.linalg.norm(
        camera.project(at)[0] - omni(at, **lens, xi=1.5, p1=1e-3)[0], axis=-1
    ).max()
    assert residual > 0.1 and worst == pytest.approx(residual, rel=0.02)


def test_the_field_of_view_is_what_pixels_can_see():
    f, equidistant = 200.0, {"k1": 0, "k2": 0, "k3": 0, "k4": 0}
    lens = partial(kannala_brandt, fx=f, fy=f, cx=500, cy=500, **equidistant)
    corner = degrees(hypot(500, 500) / f)
    # the corners are further out
    assert fit_ocam(lens, (1001, 1001))[0].max_fov_deg == pytest.approx(220)
    assert fit_ocam(lens, (1001, 1001), max_fov_deg=190)[0].max_fov_deg == pytest.approx(190)
    mask = np.hypot(*np.mgrid[-500:501, -500:501]) < f * np.radians(80)
    camera, _ = fit_ocam(lens, (1001, 1001), mask=mask)
    assert np.array_equal(camera.mask, mask) and 160 - 0.1 < camera.max_fov_deg < 161
    everything, _ = fit_ocam(lens, (1001, 1001), max_fov_deg=350)
    assert everything.max_fov_deg == pytest.approx(min(2 * corner, 350), abs=0.6)


@pytest.mark.parametrize(
    ("model", "parameters", "message"),
    [
        ("mirror", PINHOLE, "camera model 'mirror' is unknown; expected.*'ds'"),
        ("ds", PINHOLE, r"'ds' needs the parameters \['fx'.*found \['fx'"),
        ("ds", DOUBLE_SPHERE | {"alpha": 1.5}, "alpha = 1.5 .* between"),
        ("ds", DOUBLE_SPHERE | {"fx": -2.0}, "fx = -2.0"),
        ("kb4", KB4 | {"fy": 0.0}, "fy = 0.0"),
        ("ds", DOUBLE_SPHERE | {"xi": -1.5}, "xi = -1.5"),
    ],
)
def test_impossible_parameters_are_refused(model, parameters, message):
    with pytest.raises(OmnistereoError, match=message):
        make_camera_model(model, parameters)


def test_a_model_that_misses_the_image_is_refused():
    with pytest.raises(OmnistereoError, match="projects nothing into the image of 1216 × 1200"):
        fit_ocam(partial(double_sphere, **DOUBLE_SPHERE | {"cx": 1e6}), SIZE)
