"""Rig files of every format, written by hand, and the helpers of tests that read them."""

import json
import re
import warnings
from math import atan, atan2, cos, hypot, sin, tan
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from omnistereo_lib import OcamCamera, Pose
from omnistereo_lib.geometry.camera import fit_inverse_polynomial
from omnistereo_rigs.formats.read import read_any_rig

SIZE = (800, 760)  # width, height
CENTER = (402.3, 377.6)
AFFINE = (1.002, -0.003, 0.004)  # c, d, e
F = 140.0  # px


def stereographic(**changes):
    """r = 2 f tan(θ/2): the direct polynomial is exactly -f + r²/(4f); the inverse is a fit."""
    poly = [-F, 0.0, 1 / (4 * F)]
    inv_poly = fit_inverse_polynomial(poly, 220.0, 3 * max(SIZE), tolerance=2e-8)
    fields = {"poly": poly, "inv_poly": inv_poly, "center": CENTER, "affine": AFFINE}
    return OcamCamera(**fields | {"image_size": SIZE} | changes)


CAMERA = stereographic()
POLY = " ".join(map(repr, CAMERA.poly.tolist()))
INVERSE = " ".join(map(repr, CAMERA.inv_poly.tolist()))
N_INVERSE = len(CAMERA.inv_poly)
C, D, E = AFFINE
OCAM_TXT = f"""#polynomial coefficients for the DIRECT mapping function

3 {POLY}

#polynomial coefficients for the inverse mapping function

{N_INVERSE} {INVERSE}

#center: "row" and "column", starting from 0 (C convention)

{CENTER[1]} {CENTER[0]}

#affine parameters "c", "d", "e"

{C} {D} {E}

#image size: "height" and "width"

{SIZE[1]} {SIZE[0]}
"""
# The published rig: four cameras on a square, looking outwards, in centimetres, the first is the
# frame.
POSES_TXT = "0 0 0 0 0 0\n0 1.570796 0 20 0 -20\n0 3.141593 0 0 0 -40\n0 -1.570796 0 -20 0 -20\n"
DOUBLE_SPHERE = {"fx": 225.0, "fy": 222.6, "cx": 400.0, "cy": 380.0, "xi": -0.28, "alpha": 0.57}
RAYS = np.random.default_rng(3).normal(size=(300, 3))


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def ocam_folder(folder, cameras=4, poses=POSES_TXT):
    for i in range(cameras):
        write(folder / f"ocam{i + 1}.txt", OCAM_TXT)
    write(folder / "poses.txt", poses)
    return folder


def same_camera(a, b):
    for exact in (False, True):
        ours, valid = a.project(RAYS, use_direct_poly=exact)
        theirs, valid_too = b.project(RAYS, use_direct_poly=exact)
        np.testing.assert_allclose(ours[valid], theirs[valid], atol=1e-9)
        assert (valid == valid_too).all()


def omnimvs(**changes):
    """As the dialect's files look: counts that are floats, numbers that YAML takes for words."""
    camera = {
        "cam_id": 1,
        "model": "ocam",
        "poly": [3.0, *CAMERA.poly.tolist()],
        "inv_poly": [N_INVERSE, *CAMERA.inv_poly.tolist()],
        "center": [CENTER[1], CENTER[0]],
        "affine": [C, D, str(E)],
        "image_size": [SIZE[1], SIZE[0]],
        "invalid_mask": "mask1.png",
        "max_fov": 200.0,
    }
    poses = [[0, 0, 0, 0, 0, 0.6], [0, np.pi / 2, 0, 0.6, 0, 0], [0, np.pi, 0, 0, 0, -0.6]]
    cameras = [
        camera | {"pose": pose, "invalid_mask": f"mask{i + 1}.png"} for i, pose in enumerate(poses)
    ]
    config = {"omnimvs_sweep_min_depth": 1.65}
    return {"config": config, "dataset": {"start": 1}, "cameras": cameras} | changes


def dump(path, data):
    return write(path, json.dumps(data) if path.suffix == ".json" else yaml.safe_dump(data))


def basalt(**changes):
    poses = [[0, 0, 0], [0, np.pi, 0.1]]
    T_imu_cam = [
        dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_rotvec(r).as_quat().tolist(), strict=True))
        | {"px": 0.1 * i, "py": 0.0, "pz": -0.06 * i}
        for i, r in enumerate(poses)
    ]
    lens = {"camera_type": "ds", "intrinsics": DOUBLE_SPHERE}
    value = {"T_imu_cam": T_imu_cam, "intrinsics": [lens, lens], "resolution": [list(SIZE)] * 2}
    return {"value0": value | changes}


FOCAL = [300.0, 299.0, 400.0, 380.0]


def kalibr(*chain, **first):
    """A chain of double sphere cameras; `first` replaces entries of cam0."""
    lens = {"camera_model": "ds", "intrinsics": [-0.28, 0.57, *FOCAL], "distortion_model": "none"}
    lens |= {"distortion_coeffs": [], "resolution": list(SIZE), "rostopic": "/cam"}
    cameras = {f"cam{n}": lens | {"T_cn_cnm1": T.tolist()} for n, T in enumerate(chain, 1)}
    return {"cam0": lens | first} | cameras


def matrix(rotvec, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), t
    return T


K = np.array([[200.0, 0, 400], [0, 199, 380], [0, 0, 1]])
K4 = [-0.011, 0.004, -0.0021, 0.0003]
D4 = np.array(K4)
# rig -> camera, centimetres
R2, T2 = Rotation.from_rotvec([0.1, 1.4, 0]).as_matrix(), np.array([12.0, 0.5, -3.0])


def ros(**changes):
    camera = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": "left",
        "camera_matrix": {"rows": 3, "cols": 3, "data": [200.0, 0, 400, 0, 199.0, 380, 0, 0, 1]},
        "distortion_model": "equidistant",
        "distortion_coefficients": {"rows": 1, "cols": 4, "data": K4},
    }
    pose = {
        "R": {"rows": 3, "cols": 3, "data": R2.ravel().tolist()},
        "T": {"rows": 3, "cols": 1, "data": T2.tolist()},
    }
    return {"left": camera | changes, "right": camera | pose | changes}


MEI = {
    "model_type": "MEI",
    "camera_name": "fish",
    "image_width": SIZE[0],
    "image_height": SIZE[1],
    "mirror_parameters": {"xi": 1.5},
    "distortion_parameters": {"k1": -0.05, "k2": 0.01, "p1": 0.0, "p2": 0.0},
    "projection_parameters": {"gamma1": 560.0, "gamma2": 558.0, "u0": 400.0, "v0": 380.0},
}
METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>{projection}</projection>
  <width>800</width>
  <height>760</height>
  <f>240.0</f>
  <cx>3.5</cx>
  <cy>-2.0</cy>
  <b1>1.5</b1>
  <b2>-0.5</b2>
  <k1>-0.02</k1>
  <k2>0.004</k2>
  <k4>0.0001</k4>
  <date>2026-01-01T00:00:00Z</date>
</calibration>
"""
# The examples of book/own_cameras.md: name, or file of a second one → file, content.
PAGE = (Path(__file__).parents[3] / "book" / "own_cameras.md").read_text(encoding="utf-8")
EXAMPLES = {
    name or file: (file, text)
    for name, file, text in re.findall(
        r"^(?:\*\*(.*?)\*\*|and)[^`\n]*`([\w.]+)`[^\n]*\n\n```\w+\n(.*?)```$", PAGE, re.M | re.S
    )
}
AHEAD = RAYS[RAYS[:, 2] > 0.6 * np.linalg.norm(RAYS, axis=-1)]  # within 53° from the axis
WORLD = Pose.from_vector([0.3, -0.4, 0.2, 5.0, -2.0, 1.0])  # rig → world
POSES = [Pose.identity(), Pose.from_vector([0.1, 1.4, -0.2, 0.3, 0.05, -0.2])]  # camera → rig


def wxyz(R):
    """Return the quaternion w x y z of a rotation by less than 120°, by the textbook formula."""
    w = np.sqrt(1 + np.trace(R)) / 2
    xyz = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w)
    return [float(w), *xyz.tolist()]


def four_by_four(pose, axes=(1, 1, 1), scale=1):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pose.R * axes, scale * pose.t
    return T.tolist()


def transforms(**changes):
    """OpenGL: the third column points back, the second up."""
    frames = [
        {"file_path": f"{n}.png", "transform_matrix": four_by_four(WORLD @ pose, (1, -1, -1))}
        for n, pose in enumerate(POSES, 1)
    ]
    shared = {"w": SIZE[0], "h": SIZE[1], "fl_x": 200.0, "fl_y": 199.0, "cx": 400.5, "cy": 380.5}
    shared |= {"aabb_scale": 16, "camera_model": "OPENCV_FISHEYE"}
    shared |= dict(zip(("k1", "k2", "k3", "k4"), K4, strict=True))
    return shared | changes | {"frames": frames}


# Projections of one ray, written out.


def angle(x, y, z):
    """Return the angle from the axis, and the direction around it."""
    return atan2(hypot(x, y), z), atan2(y, x)


def theta_d(theta, k):
    return theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)


def kb4(x, y, z, k=K4, f=(200.0, 199.0), c=(400.0, 380.0), skew=0.0):
    theta, around = angle(x, y, z)
    x, y = theta_d(theta, k) * cos(around), theta_d(theta, k) * sin(around)
    return f[0] * x + skew * y + c[0], f[1] * y + c[1]


def brown(x, y, z, f=(400.0, 398.0), c=(400.0, 380.0), k=(-0.1, 0.01), p=(1e-5, -1e-5)):
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k[0] * r2 + k[1] * r2 * r2
    return (
        f[0] * (x * radial + 2 * p[0] * x * y + p[1] * (r2 + 2 * x * x)) + c[0],
        f[1] * (y * radial + p[0] * (r2 + 2 * y * y) + 2 * p[1] * x * y) + c[1],
    )


def mei(x, y, z, xi=1.5, f=(560, 558), c=(400, 380), k1=-0.05, k2=0.01, skew=0.0):
    """The unit sphere, seen from xi behind its centre, then radial distortion."""
    length = hypot(x, y, z)
    mx, my = x / (z + xi * length), y / (z + xi * length)
    radial = 1 + k1 * (mx**2 + my**2) + k2 * (mx**2 + my**2) ** 2
    return f[0] * mx * radial + skew * my * radial + c[0], f[1] * my * radial + c[1]


def ds(x, y, z, xi=-0.28, alpha=0.57, f=FOCAL[:2], c=FOCAL[2:]):
    length = hypot(x, y, z)
    z += xi * length
    depth = alpha * hypot(x, y, z) + (1 - alpha) * z
    return f[0] * x / depth + c[0], f[1] * y / depth + c[1]


def eucm(x, y, z, alpha=0.6, beta=1.1, f=(200, 199), c=(400, 380)):
    depth = alpha * (beta * (x * x + y * y) + z * z) ** 0.5 + (1 - alpha) * z
    return f[0] * x / depth + c[0], f[1] * y / depth + c[1]


def fov(x, y, z, w=0.9, f=FOCAL[:2], c=(400, 380)):
    theta, around = angle(x, y, z)
    r = atan(2 * tan(theta) * tan(w / 2)) / w
    return f[0] * r * cos(around) + c[0], f[1] * r * sin(around) + c[1]


def follows(camera, pixel, rays=AHEAD, atol=0.02, least=0.6):
    """Check that a camera projects rays as `pixel(x, y, z)`, a formula for one ray, does."""
    uv, valid = camera.project(rays)
    assert valid.mean() > least
    np.testing.assert_allclose(uv[valid], np.array([pixel(*ray) for ray in rays])[valid], atol=atol)


def same(rig, poses=None):
    """Check camera → first camera."""
    poses = POSES if poses is None else poses
    for ours, true in zip(rig.T_rig_cam, poses, strict=True):
        ours, true = rig.T_rig_cam[0].inverse() @ ours, poses[0].inverse() @ true
        np.testing.assert_allclose(ours.R, true.R, atol=1e-9)
        np.testing.assert_allclose(ours.t, true.t, atol=1e-9)


def read(path, data=None, unit=None, **options):
    """Return the rig of a file, in its own frame, and what was said about it."""
    if data is not None:
        write(path, data) if isinstance(data, str) else dump(path, data)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rig = read_any_rig(path, unit, **{"keep_frame": True} | options)
    return rig, [str(each.message) for each in said]
