"""Other camera models against formulas for one ray, against OpenCV, and as OCam cameras."""

from functools import partial
from math import acos, asin, degrees, hypot, sqrt

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from rigs.formats.rig_file_samples import AHEAD, brown, ds, eucm, fov, kb4, mei
from scene import polar_rays, refused

from omnistereo_rigs.formats.camera_models import FISHEYE, make_camera_model
from omnistereo_rigs.formats.colmap import MODELS
from omnistereo_rigs.formats.fit import fit_ocam

SIZE = (1216, 1200)
PINHOLE = {"fx": 225.0, "fy": 222.5, "cx": 610.8, "cy": 600.2}
OMNI = PINHOLE | {"fx": 560.0, "fy": 556.0, "xi": 1.5}
K4 = (-0.011, 0.004, -0.0021, 0.0003)
KB4 = PINHOLE | {"fx": 320.0, "fy": 321.0} | dict(zip(FISHEYE, K4, strict=True))
DOUBLE_SPHERE = PINHOLE | {"xi": -0.28, "alpha": 0.57}
AT = {"f": (225.0, 222.5), "c": (610.8, 600.2)}


def rays(theta_deg, azimuths=16):
    theta = np.radians(np.atleast_1d(theta_deg))[:, None]
    return polar_rays(theta, np.arange(azimuths) * 2 * np.pi / azimuths)


points = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 3)).filter(
    lambda p: hypot(*p) > 0.1
)
# Mei's sphere with xi = alpha / (1 - alpha) is the unified model, with other focal lengths.
BY_HAND = [
    ("ds", DOUBLE_SPHERE, partial(ds, xi=-0.28, alpha=0.57, **AT)),
    ("eucm", PINHOLE | {"alpha": 0.6, "beta": 1.1}, partial(eucm, alpha=0.6, beta=1.1, **AT)),
    ("kb4", KB4, partial(kb4, k=K4, f=(320, 321), c=AT["c"])),
    ("kb4", KB4 | {"skew": 1.5}, partial(kb4, k=K4, f=(320, 321), c=AT["c"], skew=1.5)),
    ("omni", OMNI | {"k1": -0.05, "k2": 0.01}, partial(mei, f=(560, 556), c=AT["c"])),
    ("ucm", OMNI | {"alpha": 0.6}, partial(mei, f=(560 * 2.5, 556 * 2.5), c=AT["c"], k1=0, k2=0)),
    ("fov", PINHOLE | {"w": 0.9}, partial(fov, w=0.9, **AT)),
    ("pinhole", PINHOLE | {"k1": -0.1, "k2": 0.01}, partial(brown, p=(0, 0), **AT)),
]


@pytest.mark.parametrize(("model", "parameters", "by_hand"), BY_HAND)
@given(points)
@example((0.0, 6e-303, -1.0))
def test_models_by_hand(model, parameters, by_hand, point):
    parameters = {k: v for k, v in parameters.items() if not (model == "ucm" and k == "xi")}
    uv, valid = make_camera_model(model, parameters)(np.array(point))
    if valid:
        np.testing.assert_allclose(uv, by_hand(*point), atol=1e-6)


def test_omni_distortion_is_opencvs():
    """OpenCV's pinhole camera has the same distortion, on the plane that sees the sphere."""
    at = rays(np.arange(1, 60, 7))
    distortion = {"k1": 0.01, "k2": -0.002, "p1": 0.003, "p2": -0.001}
    ours, valid = make_camera_model("omni", PINHOLE | {"xi": 1.5} | distortion)(at)
    moved = at.reshape(-1, 3) + np.array([0, 0, 1.5])
    K = np.array([[225.0, 0, 610.8], [0, 222.5, 600.2], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(
        moved, np.zeros(3), np.zeros(3), K, np.array(list(distortion.values()))
    )
    assert valid.all()
    np.testing.assert_allclose(ours.reshape(-1, 2), theirs.reshape(-1, 2), atol=1e-6)


W1 = (1 - 0.57) / 0.57
ENDS = [
    (90 + degrees(asin((W1 - 0.28) / sqrt(1 - 2 * W1 * 0.28 + 0.28**2))), "ds", DOUBLE_SPHERE),
    (90 + degrees(asin(0.4 / 0.6)), "ucm", PINHOLE | {"alpha": 0.6}),
    (degrees(acos(-0.8)), "omni", PINHOLE | {"xi": 0.8}),
    (degrees(1.0), "kb4", PINHOLE | {"k1": -1 / 3}),
    (60, "pinhole", PINHOLE),
]


@pytest.mark.parametrize(("end", "model", "parameters"), ENDS)
def test_each_model_says_where_it_ends(end, model, parameters):
    project = make_camera_model(model, parameters)
    assert project(rays([end - 0.01]))[1].all() and not project(rays([end + 0.01]))[1].any()
    assert not project(np.zeros(3))[1]


RADIAL = [
    ("ds", DOUBLE_SPHERE),
    ("kb4", KB4),
    ("eucm", PINHOLE | {"alpha": 0.6, "beta": 1.05}),
    ("omni", OMNI | {"k1": -0.01, "k2": 0.002}),
]


@pytest.mark.parametrize(("model", "parameters"), RADIAL)
def test_radial_models_become_ocam_cameras(model, parameters):
    project = make_camera_model(model, parameters)
    camera, residual = fit_ocam(project, SIZE)
    assert residual < 0.02 and camera.max_fov_deg > 200
    # not where it was fitted
    at = rays(np.linspace(0.05, camera.max_fov_deg / 2 - 0.05, 311), azimuths=37)
    theirs, _ = project(at)
    for exact in (False, True):
        ours, valid = camera.project(at, use_direct_poly=exact)
        assert valid.mean() > 0.9
        assert np.abs(ours - theirs).max() < 0.02
    assert camera.affine[0] == pytest.approx(parameters["fy"] / parameters["fx"], abs=1e-9)
    np.testing.assert_allclose(camera.center, (610.8, 600.2), atol=1e-6)
    assert camera.inverse_poly_error_px() < 0.05


def test_tangential_distortion_shows_in_the_residual():
    def fitted(p1):
        project = make_camera_model("omni", OMNI | {"p1": p1})
        return project, *fit_ocam(project, SIZE)

    residuals = [fitted(p1)[2] for p1 in (0.0, 1e-4, 1e-3)]
    assert residuals[0] < 0.02 < residuals[1] < residuals[2]
    project, camera, residual = fitted(1e-3)
    at = rays(np.linspace(0.1, camera.max_fov_deg / 2, 200))
    worst = np.linalg.norm(camera.project(at)[0] - project(at)[0], axis=-1).max()
    assert residual > 0.1 and worst == pytest.approx(residual, rel=0.02)


def test_the_field_of_view_is_what_pixels_can_see():
    f = 200.0
    lens = make_camera_model("kb4", {"fx": f, "fy": f, "cx": 500, "cy": 500})
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
        ("ds", DOUBLE_SPHERE | {"cx": 1e5}, "projects nothing into the image of 1216 × 1200"),
    ],
)
def test_impossible_parameters_are_refused(model, parameters, message):
    with refused(message):
        fit_ocam(make_camera_model(model, parameters), SIZE)


THEIRS = {
    "SIMPLE_FISHEYE": [200.0, 400.5, 380.5],
    "FISHEYE": [200.0, 199.0, 400.5, 380.5],
    "OPENCV_FISHEYE": [200.0, 199.0, 400.5, 380.5, *K4],
    "SIMPLE_RADIAL_FISHEYE": [200.0, 400.5, 380.5, -0.01],
    "RADIAL_FISHEYE": [200.0, 400.5, 380.5, -0.01, 0.004],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(200.0, 199, 400.5, 380.5, 0.01, -0.02, 3e-3, 1e-4, 0, 1e-5),
        *(1e-3, -2e-3, 2e-3, 1e-4, -1e-3, 3e-4),
    ],
    "EUCM": [220.0, 219.0, 400.5, 380.5, 0.6, 1.1],
    "FOV": [300.0, 299.0, 400.5, 380.5, 0.9],
    "FULL_OPENCV": [400.0, 398, 400.5, 380.5, 0.1, -0.02, 1e-3, -1e-3, 0.01, 0.02, -0.01, 1e-3],
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", THEIRS)
def test_models_against_colmap_itself(name, pycolmap):
    theirs = pycolmap.Camera(model=name, width=800, height=760, params=THEIRS[name])
    model, names = MODELS[name.lower()][0], MODELS[name.lower()][1]["camera_params"]
    stated = dict(zip(names, THEIRS[name], strict=True))
    if "f" in stated:
        stated["fx"] = stated["fy"] = stated.pop("f")
    uv, valid = make_camera_model(model, stated)(AHEAD)
    expected = np.stack([theirs.img_from_cam(ray) for ray in AHEAD])
    assert valid.all() and len(AHEAD) > 30
    np.testing.assert_allclose(uv, expected, atol=1e-9)
