"""Files of ROS, VINS, camodocal, Metashape, Hugin, and Kalibr's other names: pixels against
formulas written here."""

import json
import warnings
from math import atan, atan2, cos, hypot, pi, sin, tan

import cv2
import numpy as np
import pytest
from rig_file_samples import (
    FOCAL,
    HUGIN,
    K4,
    MEI,
    METASHAPE,
    RAYS,
    T2,
    dump,
    kalibr,
    matrix,
    ros,
    write,
)

from omnistereo_lib import OmnistereoError
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig

AHEAD = RAYS[RAYS[:, 2] > 0.6 * np.linalg.norm(RAYS, axis=-1)]  # within 53° from the axis


def follows(camera, pixel, rays=AHEAD, atol=0.02, least=0.6):
    """Check that a camera projects rays as `pixel(x, y, z)`, a formula for one ray, does."""
    uv, valid = camera.project(rays)
    assert valid.mean() > least
    np.testing.assert_allclose(uv[valid], np.array([pixel(*ray) for ray in rays])[valid], atol=atol)


def angle(x, y, z):
    """Return the angle from the axis, and the direction around it."""
    return atan2(hypot(x, y), z), atan2(y, x)


def theta_d(theta, k):
    return theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)


def kb4(x, y, z, skew=0.0):
    theta, around = angle(x, y, z)
    mx, my = theta_d(theta, K4) * cos(around), theta_d(theta, K4) * sin(around)
    return 200.0 * mx + skew * my + 400.0, 199.0 * my + 380.0


def test_matrices_of_ros(tmp_path):
    rig = read_any_rig(dump(tmp_path / "rig.yaml", ros()), "cm")
    np.testing.assert_allclose(rig.T_rig_cam[1].inverse().t, T2 / 100, atol=1e-12)
    follows(rig.cameras[1], kb4)
    wrong_columns = {5: " must be 5 numbers, found 4", 1e300: " is 1e.300; expected an integer"}
    for columns, message in wrong_columns.items():
        wrong = ros(distortion_coefficients={"rows": 1, "cols": columns, "data": K4})
        with pytest.raises(OmnistereoError, match="distortion_coefficients" + message):
            read_any_rig(dump(tmp_path / "rig.yaml", wrong), "cm")


def test_fisheye_with_skew(tmp_path):
    skewed = ros(camera_matrix=[200.0, 1.5, 400, 0, 199.0, 380, 0, 0, 1])
    rig = read_any_rig(dump(tmp_path / "rig.yaml", skewed), "cm")
    follows(rig.cameras[0], lambda x, y, z: kb4(x, y, z, skew=1.5))


def test_xml_entities_are_refused(tmp_path):
    text = '<!DOCTYPE a [<!ENTITY b "bb">]><opencv_storage>&b;</opencv_storage>'
    with pytest.raises(OmnistereoError, match=r"rig.xml: XML with a document type"):
        read_any_rig(write(tmp_path / "rig.xml", text))
    with pytest.raises(OmnistereoError, match=r"rig.xml: not valid XML .*complete"):
        read_any_rig(write(tmp_path / "rig.xml", "<opencv_storage><K1>"))


def in_opencv(x, y, z, D):
    K = np.array([[400.0, 0, 400], [0, 399, 380], [0, 0, 1]])
    return cv2.projectPoints(np.array([[[x, y, z]]]), np.zeros(3), np.zeros(3), K, np.array(D))[
        0
    ].ravel()


@pytest.mark.parametrize(
    ("name", "D"),
    [
        ("plumb_bob", [-0.31, 0.115, 0.0, 0.0, 0.0]),
        ("plumb_bob", [-0.2, 0.05, 0.0, 0.0]),
        ("rational_polynomial", [0.3, 0.02, 0.0, 0.0, 0.001, 0.5, 0.06, 0.003]),
    ],
)
def test_a_pinhole_camera_is_no_fisheye(tmp_path, name, D):
    K = [400.0, 0, 400, 0, 399.0, 380, 0, 0, 1]
    rig = read_any_rig(
        dump(
            tmp_path / "rig.yaml",
            ros(distortion_model=name, distortion_coefficients=D, camera_matrix=K),
        ),
        "cm",
    )
    follows(rig.cameras[0], lambda x, y, z: in_opencv(x, y, z, D))
    assert 90 < rig.cameras[0].max_fov_deg <= 120


def test_pinhole_cameras_end_at_120_degrees(tmp_path):
    K = [200.0, 0, 400, 0, 200.0, 380, 0, 0, 1]
    wide = ros(distortion_model="plumb_bob", distortion_coefficients=[0.0] * 5, camera_matrix=K)
    camera = read_any_rig(dump(tmp_path / "rig.yaml", wide), "cm").cameras[0]
    assert 119 < camera.max_fov_deg <= 120
    follows(camera, lambda x, y, z: (200 * x / z + 400, 200 * y / z + 380))


@pytest.mark.parametrize(
    "changes", [{"distortion_model": "thin_prism"}, {"distortion_model": "mei"}, {"xi": 0.5}]
)
def test_other_models_are_not_taken_for_a_fisheye(tmp_path, changes):
    with pytest.raises(
        OmnistereoError, match=r"camera left: the camera model is .*; expected fisheye .equidistant"
    ):
        read_any_rig(dump(tmp_path / "rig.yaml", ros(**changes)), "cm")


def mei(x, y, z, xi, f, c, k1, k2, skew=0.0):
    """The unit sphere, seen from xi behind its centre, then radial distortion."""
    length = hypot(x, y, z)
    mx, my = x / (z + xi * length), y / (z + xi * length)
    radial = 1 + k1 * (mx**2 + my**2) + k2 * (mx**2 + my**2) ** 2
    return f[0] * mx * radial + skew * my * radial + c[0], f[1] * my * radial + c[1]


def test_the_omnidirectional_model_of_opencv(tmp_path):
    K = [500.0, 1.0, 400, 0, 498.0, 380, 0, 0, 1]
    omnidir = ros(camera_matrix=K, distortion_coefficients=[-0.1, 0.02, 0.0, 0.0], xi=1.2)
    for cam in omnidir.values():
        del cam["distortion_model"]
    rig = read_any_rig(dump(tmp_path / "rig.yaml", omnidir), "cm")
    follows(
        rig.cameras[0],
        lambda x, y, z: mei(x, y, z, 1.2, (500, 498), (400, 380), -0.1, 0.02, skew=1.0),
    )


def test_rigs_of_vins_with_cameras_of_camodocal(tmp_path):
    k = dict(zip(("k2", "k3", "k4", "k5"), K4, strict=True))
    projection = {"mu": 200.0, "mv": 199.0, "u0": 400.0, "v0": 380.0}
    kannala = {key: MEI[key] for key in ("image_width", "image_height")} | {
        "projection_parameters": k | projection
    }
    dump(tmp_path / "front.yaml", MEI)
    dump(tmp_path / "back.yaml", {"model_type": "KANNALA_BRANDT"} | kannala)
    front, back = matrix([0, 0, 0], [0.1, 0, 0]), matrix([0, 3, 0], [-0.1, 0.02, 0])
    config = {"imu": 1, "num_of_cam": 2, "cam0_calib": "front.yaml", "cam1_calib": "back.yaml"}
    poses = {
        f"body_T_cam{i}": {"rows": 4, "cols": 4, "data": T.ravel().tolist()}
        for i, T in enumerate((front, back))
    }
    rig = read_any_rig(dump(tmp_path / "vins.yaml", config | poses))
    # camera -> body, as it stands
    np.testing.assert_allclose(rig.T_rig_cam[1].R, back[:3, :3], atol=1e-12)
    np.testing.assert_allclose(rig.centers, [[0.1, 0, 0], [-0.1, 0.02, 0]])
    follows(
        rig.cameras[0],
        lambda x, y, z: mei(x, y, z, 1.5, (560, 558), (400, 380), -0.05, 0.01),
        RAYS,
        least=0.3,
    )
    follows(rig.cameras[1], kb4)
    with pytest.raises(
        OmnistereoError,
        match=r"model_type is OTHER; expected one of MEI, KANNALA_BRANDT, PINHOLE, SCA",
    ):
        read_any_camera(dump(tmp_path / "other.yaml", {"model_type": "other"}))


def test_scaramuzza_of_camodocal(tmp_path):
    """An equidistant lens of 210 px per radian."""
    inv_poly = {"p0": 210 * pi / 2, "p1": 210.0} | {f"p{k}": 0.0 for k in range(2, 20)}
    radii = np.linspace(1, 380, 400)
    direct = np.polynomial.Polynomial.fit(
        radii, -radii / np.tan(radii / 210), 10, domain=(-1, 1), window=(-1, 1)
    )
    affine = {"ac": 1.02, "ad": 0.003, "ae": -0.002, "cx": 401.0, "cy": 379.0}
    content = {
        "model_type": "SCARAMUZZA",
        "image_width": 800,
        "image_height": 768,
        "affine_parameters": affine,
    }
    content |= {"poly_parameters": {f"p{k}": float(a) for k, a in enumerate(direct.coef)}}
    camera = read_any_camera(
        dump(tmp_path / "lens.yaml", content | {"inv_poly_parameters": inv_poly})
    )

    def pixel(x, y, z):
        theta, around = angle(x, y, z)
        x, y = 210 * theta * cos(around), 210 * theta * sin(around)
        return 1.02 * x + 0.003 * y + 401, -0.002 * x + y + 379

    follows(camera, pixel)


@pytest.mark.parametrize(
    ("projection", "radius"),
    [
        ("equidistant_fisheye", lambda theta: theta),
        ("equisolid_fisheye", lambda theta: 2 * sin(theta / 2)),
        ("frame", tan),
    ],
)
def test_lenses_of_metashape(tmp_path, projection, radius):
    def pixel(x, y, z):
        theta, around = angle(x, y, z)
        r = radius(theta)
        r *= 1 - 0.02 * r**2 + 0.004 * r**4 + 0.0001 * r**8
        x, y = r * cos(around), r * sin(around)
        # The centre of the top-left pixel is (0.5, 0.5) there.
        return 400 + 3.5 + 241.5 * x - 0.5 * y - 0.5, 380 - 2.0 + 240 * y - 0.5

    camera = read_any_camera(write(tmp_path / "lens.xml", METASHAPE.format(projection=projection)))
    follows(camera, pixel)


def test_decentring_of_metashape(tmp_path):
    """Its p1 multiplies r² + 2x² in x: small, since an OCam camera does not follow it."""
    text = METASHAPE.format(projection="frame").replace(
        "<k4>0.0001</k4>", "<p1>1e-4</p1><p2>0</p2><p3>0.5</p3>"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        camera = read_any_camera(write(tmp_path / "lens.xml", text))

    def pixel(x, y, z):
        x, y = x / z, y / z
        r2 = x * x + y * y
        radial = 1 - 0.02 * r2 + 0.004 * r2**2
        p1 = 1e-4 * (1 + 0.5 * r2)
        x, y = x * radial + p1 * (r2 + 2 * x * x), y * radial + 2 * p1 * x * y
        return 403.0 + 241.5 * x - 0.5 * y, 377.5 + 240 * y

    follows(camera, pixel, atol=0.25)


@pytest.mark.parametrize(
    ("suffix", "kind", "radius"),
    [
        (".pto", 3, lambda t: t),
        (".ini", 0, tan),
        (".pto", 21, lambda t: 2 * sin(t / 2)),
        (".ini", 3, lambda t: t),
    ],
)
def test_lenses_of_hugin(tmp_path, suffix, kind, radius):
    view = 100.0 if kind == 0 else 180.0
    text = {
        ".pto": (
            f"# hugin project file\np f2 w3000 h1500 v360\ni w800 h760 f{kind} v{view} Ra0 Rb0"
            ' a0.01 b-0.02 c0.005 d2.5 e-1.5 g0 t0 r0 p0 y0 TrX0 j0 Vm5 n"a0.jpg"\ni w800 h760 f=0'
            ' v=0 a=0 r1 p2 y3 n"b.jpg"\n'
        ),
        ".ini": (
            f"[Lens]\nimage_width=800\nimage_height=760\ntype={kind}\nhfov={view}\nhfov_link=1\na=0.01\nb=-0.02\n"
            "c=0.005\nd=2.5\ne=-1.5\n"
        ),
    }[suffix]
    f = 400 / radius(np.radians(view / 2))

    def pixel(x, y, z):
        theta, around = angle(x, y, z)
        rho = f * radius(theta) / 380
        r = 380 * rho * (0.01 * rho**3 - 0.02 * rho**2 + 0.005 * rho + 1.005)
        return 399.5 + 2.5 + r * cos(around), 379.5 - 1.5 + r * sin(around)

    follows(read_any_camera(write(tmp_path / f"lens{suffix}", text)), pixel)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (
            "lens.xml",
            METASHAPE.format(projection="spherical"),
            "projection is spherical; .*depth needs two",
        ),
        (
            "pano.pto",
            'i w8000 h4000 f4 v360 a0 b0 c0 n"a.jpg"\n',
            "f is 4; .*depth needs two",
        ),
        ("lens.pto", HUGIN.replace("g0", "g0.5"), r"the lens is sheared \(g, t\)"),
        ("lens.ini", "[Camera]\nw=1\n", "lens.ini: not a lens file of Hugin"),
        (
            "pano.pto",
            "i w800 h760 f3 v0\n",
            "field of view v in degrees is 0.0; expected a number of 1 to 360",
        ),
        (
            "pano.json",
            json.dumps({"project": {"globallenses": []}}),
            "PTGui projects are not read: .*Hugin",
        ),
        (
            "chunk.xml",
            "<document><chunk/></document>",
            "Metashape projects are not read: save the calibration",
        ),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, name, text, message):
    with pytest.raises(OmnistereoError, match=message):
        read_any_camera(write(tmp_path / name, text))


def equidistant(x, y, z):
    theta, around = angle(x, y, z)
    return (
        FOCAL[0] * theta_d(theta, K4) * cos(around) + 400,
        FOCAL[1] * theta_d(theta, K4) * sin(around) + 380,
    )


def atan_model(x, y, z):
    theta, around = angle(x, y, z)
    r = atan(2 * tan(theta) * tan(0.45)) / 0.9
    return FOCAL[0] * r * cos(around) + 400, FOCAL[1] * r * sin(around) + 380


def double_sphere(x, y, z, xi=-0.28, alpha=0.57):
    length = hypot(x, y, z)
    z += xi * length
    depth = alpha * hypot(x, y, z) + (1 - alpha) * z
    return FOCAL[0] * x / depth + 400, FOCAL[1] * y / depth + 380


@pytest.mark.parametrize(
    ("entries", "pixel"),
    [
        (
            {"camera_model": "pinhole", "distortion_model": "equi", "distortion_coeffs": K4},
            equidistant,
        ),
        (
            {"camera_model": "Pinhole", "distortion_model": "fov", "distortion_coeffs": [0.9]},
            atan_model,
        ),
        ({"intrinsics": [-0.28, 0.57, *FOCAL]}, double_sphere),
        (
            {"camera_model": "omni", "intrinsics": [1.5, *FOCAL], "distortion_model": "radtan"}
            | {"distortion_coeffs": [-0.01, 0.002, 0.0, 0.0]},
            lambda *X: mei(*X, 1.5, FOCAL[:2], FOCAL[2:], -0.01, 0.002),
        ),
        (
            {
                "camera_model": "pinhole",
                "distortion_model": "radtan",
                "distortion_coeffs": [0.0] * 4,
            },
            lambda x, y, z: (FOCAL[0] * x / z + 400, FOCAL[1] * y / z + 380),
        ),
    ],
)
def test_other_names_and_models_of_kalibr(tmp_path, entries, pixel):
    chain = kalibr(np.eye(4), **{"intrinsics": FOCAL} | entries)
    if "distortion_model" not in entries:
        del chain["cam0"]["distortion_model"]
    follows(read_any_rig(dump(tmp_path / "chain.yaml", chain)).cameras[0], pixel)


@pytest.mark.parametrize("key", ["T_cam_imu", "T_imu_cam"])
def test_chains_by_the_imu_alone(tmp_path, key):
    T_cam_imu = [matrix([0.1, 0, 0.02], [0.01, 0.02, 0.03]), matrix([0.1, 1.2, 0], [0.1, 0, 0.2])]
    chain = kalibr(np.eye(4))
    for i, T in enumerate(T_cam_imu):
        chain[f"cam{i}"].pop("T_cn_cnm1", None)
        chain[f"cam{i}"][key] = (T if key == "T_cam_imu" else np.linalg.inv(T)).tolist()
    rig = read_any_rig(dump(tmp_path / "chain.yaml", chain))
    point = np.array([0.3, -0.2, 2.0, 1.0])  # in the frame of the IMU
    np.testing.assert_allclose(
        rig.T_rig_cam[1] @ (T_cam_imu[1] @ point)[:3], (T_cam_imu[0] @ point)[:3], atol=1e-12
    )
    del chain["cam1"][key]
    with pytest.raises(
        OmnistereoError, match=r"cam1: no pose; .*expected T_cn_cnm1, T_cam_imu, .* in every camera"
    ):
        read_any_rig(dump(tmp_path / "chain.yaml", chain))
