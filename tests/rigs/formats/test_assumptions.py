"""What a rig file assumes is checked: frame, contradictions, keys, field of view, centre."""

import logging
import re
import warnings

import numpy as np
import pytest
from rigs.formats.rig_file_samples import (
    CAMERA,
    CENTER,
    INVERSE,
    N_INVERSE,
    OCAM_TXT,
    SIZE,
    dump,
    kalibr,
    matrix,
    stereographic,
    write,
)
from scene import refused
from scipy.spatial.transform import Rotation

from omnistereo_lib import Pose, Rig, save_rig
from omnistereo_lib.geometry.camera import fit_inverse_polynomial
from omnistereo_rigs.formats.read import read_any_camera, read_any_rig
from omnistereo_tools import cli

# camera axes (x right, y down, z forward) in x forward, z up
FLU = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])


def ring(R=None, rolls=(0, 0, 0, 0), tilt=0.0):
    """Return four cameras around a circle, in a frame rotated by R, rolled and tilted."""
    poses = []
    for quarter, roll in enumerate(rolls):
        around = Rotation.from_rotvec([0, quarter * np.pi / 2, 0])
        turned = around * Rotation.from_euler("xz", [tilt, roll], degrees=True)
        poses.append(Pose(turned.as_matrix(), around.apply([0, 0, 0.1])))
    rig = Rig((CAMERA,) * 4, tuple(poses))
    return rig if R is None else rig.with_poses([Pose(R, np.zeros(3)) @ pose for pose in poses])


def loaded(rig, folder, **options):
    """Return what `load_rig` makes of a rig that was never loaded before."""
    save_rig(rig, folder / "rig.yaml")
    return read_any_rig(folder / "rig.yaml", **options)


def down(rig):
    return np.mean([pose.R[:, 1] for pose in rig.T_rig_cam], axis=0)


def test_a_rig_in_the_frame_of_a_robot_is_turned_level(tmp_path, caplog):
    with caplog.at_level(logging.INFO, "omnistereo_lib"):
        rig = loaded(ring(FLU), tmp_path)
    assert "down is 90° from +y of the rig: the rig is turned level, by 120°" in caplog.text
    np.testing.assert_allclose(down(rig), [0, 1, 0], atol=1e-12)
    # the first camera to the front
    np.testing.assert_allclose(rig.T_rig_cam[0].R[:, 2], [0, 0, 1], atol=1e-12)
    # The turn is stated: with it, poses are those of the file again.
    back = rig.T_rig_file.inverse() @ rig.T_rig_cam[1]
    np.testing.assert_allclose(back.R, ring(FLU).T_rig_cam[1].R, atol=1e-12)
    kept = loaded(ring(FLU), tmp_path, keep_frame=True)
    np.testing.assert_allclose(kept.T_rig_cam[1].R, ring(FLU).T_rig_cam[1].R, atol=1e-12)


@pytest.mark.parametrize("quarter", [-1, 1])
def test_where_the_first_camera_looks_up_or_down_the_top_of_its_image_is_ahead(tmp_path, quarter):
    first, *others = ring(FLU).T_rig_cam
    turned = first @ Pose.from_vector([quarter * np.pi / 2, 0, 0, 0, 0, 0])
    rig = loaded(ring(FLU).with_poses([turned, *others]), tmp_path)
    np.testing.assert_allclose(rig.T_rig_cam[1].R[:, 1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(rig.T_rig_cam[0].R[:, 1], [0, 0, -1], atol=1e-12)


def test_a_rig_that_was_loaded_keeps_its_frame(tmp_path):
    kept = loaded(ring(FLU), tmp_path, keep_frame=True)
    again = loaded(kept, tmp_path)
    np.testing.assert_allclose(again.T_rig_cam[2].R, kept.T_rig_cam[2].R, atol=1e-12)
    turned = loaded(ring(FLU), tmp_path)
    moved = loaded(turned.recentered([0.1, 0, 0]), tmp_path)
    np.testing.assert_allclose(moved.T_rig_file @ np.zeros(3), [-0.1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("rolls", [(90, 0, 0, 0), (180, 0, 0, 0), (30, 0, 0, 0)])
def test_a_rolled_first_camera_does_not_tilt_the_rig(tmp_path, rolls):
    """The rig frame of a Kalibr chain is its first camera, however it is mounted."""
    rig = ring(rolls=rolls)
    rig = rig.transformed(rig.T_rig_cam[0].inverse())
    rig = loaded(Rig(rig.cameras, rig.T_rig_cam), tmp_path)
    level = [pose.R[:, 1] for pose in rig.T_rig_cam][1:]
    assert np.degrees(np.arccos(np.mean(level, 0)[1])) < 10
    assert abs(np.linalg.svd(rig.centers - rig.centers.mean(0))[2][2] @ [0, 1, 0]) > np.cos(
        np.radians(10)
    )


@pytest.mark.parametrize("tilt", [0, 3, -35])
def test_a_level_rig_is_left_alone(tmp_path, tilt):
    rig = ring(tilt=tilt)
    back = loaded(rig, tmp_path)
    for ours, theirs in zip(back.T_rig_cam, rig.T_rig_cam, strict=True):
        np.testing.assert_allclose(ours.R, theirs.R, atol=1e-12)


def test_cameras_that_do_not_agree_are_said(tmp_path):
    sideways = ring(Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix(), rolls=(90, 90, 90, 90))
    with pytest.warns(UserWarning, match=r"do not agree which way is down, .* no horizontal plane"):
        loaded(sideways, tmp_path)


def test_poses_that_are_stated_twice_are_compared(tmp_path):
    """T_cam_imu of the second camera is 30 cm and 180° from what the chain says."""
    chain = matrix([0, np.pi, 0], [0, 0, 0.3])
    rig = kalibr(chain, T_cam_imu=np.eye(4).tolist())
    rig["cam1"]["T_cam_imu"] = matrix([0, 0, 0], [0, 0, 0]).tolist()
    with pytest.warns(
        UserWarning, match=r"T_cn_cnm1 and T_cam_imu contradict.*camera 2.*30.0 cm and 180.0° apart"
    ):
        read_any_rig(dump(tmp_path / "rig.yaml", rig))
    rig["cam1"]["T_cam_imu"] = chain.tolist()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_any_rig(dump(tmp_path / "rig.yaml", rig))


def test_a_narrow_ocam_lens_ends_where_its_image_does(tmp_path):
    """r = 2 f tan(θ/2), 200 px to the border; its polynomial stops increasing at 150°."""
    f, size = 325.0, (400, 300)
    theta = np.linspace(0, np.radians(75), 200)
    inverse = (
        np.polynomial.Polynomial.fit(theta - np.pi / 2, 2 * f * np.tan(theta / 2), 9).convert().coef
    )
    poly = [-f, 0.0, 1 / (4 * f)]
    text = (
        f"3 {poly[0]} 0 {poly[2]}\n{len(inverse)} {' '.join(map(str, inverse))}\n149.5 199.5\n1 0"
        " 0\n300 400\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = read_any_camera(write(tmp_path / "ocam1.txt", text))
    corner = 4 * np.degrees(np.arctan(np.hypot(*size) / 2 / (2 * f)))
    assert corner - 3 < camera.max_fov_deg <= corner  # rays are tried every 6° around the axis
    without = read_any_camera(write(tmp_path / "ocam2.txt", text.replace(text.splitlines()[1], "")))
    np.testing.assert_allclose(
        without.project([0.5, 0.2, 1])[0], camera.project([0.5, 0.2, 1])[0], atol=0.02
    )


def test_a_polynomial_that_is_used_nowhere_does_not_matter(tmp_path):
    """Beyond the image, poly bends away from inv_poly and then has no ray at all."""
    bent = [*CAMERA.poly.tolist(), 0.0, 0.0, 0.0, 0.0, -1e-18]
    visible = np.hypot(*SIZE) / 2
    with_and_without = [np.polynomial.Polynomial(poly)(visible) for poly in (bent, bent[:3])]
    assert np.ptp(with_and_without) > 1
    text = OCAM_TXT.replace("\n3 ", f"\n{len(bent)} ").replace(
        repr(CAMERA.poly[2].item()), " ".join(map(repr, bent[2:]))
    )
    small = text.replace(f"{SIZE[1]} {SIZE[0]}", "240 240").replace(
        f"{CENTER[1]} {CENTER[0]}", "119.5 119.5"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_any_camera(write(tmp_path / "ocam1.txt", small))
    with pytest.warns(UserWarning, match=r"disagree.*delete inv_poly from the file"):
        read_any_camera(write(tmp_path / "ocam2.txt", text))
    advised = text.replace(f"{N_INVERSE} {INVERSE}", "0")
    fitted = read_any_camera(write(tmp_path / "ocam3.txt", advised), 150)
    assert fitted.inverse_poly_error_px() < 0.01
    expected = fit_inverse_polynomial(bent, 150, 3 * max(SIZE))
    np.testing.assert_allclose(fitted.inv_poly, expected)


@pytest.mark.parametrize(
    "changes",
    [
        {"center": (379.5, 639.5), "image_size": (1280, 760)},
        {"center": (199.5, 189.5), "image_size": (800, 760)},
        {"center": (250.0, 400.0)},
    ],
)
def test_an_implausible_principal_point_is_said(tmp_path, changes):
    said = r"camera 1: the principal point is .*height, row and column are not swapped, and that "
    with pytest.warns(UserWarning, match=rf"{said}the image size is .*Likewise camera 2, 3, 4"):
        loaded(Rig((stereographic(**changes),) * 4, ring().T_rig_cam), tmp_path)


@pytest.mark.parametrize("c", [-1.0, 0.5, 50.0])
def test_pixels_that_are_no_squares_are_said(tmp_path, c):
    said = rf"camera 1: fy is {c:.3g} times fx .*Likewise camera 2, 3, 4"
    with pytest.warns(UserWarning, match=said):
        loaded(Rig((stereographic(affine=(c, 0.0, 0.0)),) * 4, ring().T_rig_cam), tmp_path)


def test_a_camera_that_is_a_copy_is_said(tmp_path):
    poses = ring().T_rig_cam
    rig = Rig((stereographic(),) * 5, (*poses[:2], poses[1], *poses[2:]))
    with pytest.warns(UserWarning, match="cameras 2 and 3 have the same pose; expected another"):
        loaded(rig, tmp_path)


@pytest.mark.parametrize(("scale", "far"), [(1000, "173 m"), (0.01, "0.00173 m"), (1, None)])
def test_positions_in_another_unit_are_doubted(tmp_path, capsys, scale, far):
    """Of a rig of 17 cm in files whose unit is metres, one of them with millimetres."""
    data = kalibr(matrix([0, np.pi / 2, 0], scale * np.array([0.1, 0.1, 0.1])))
    path = dump(tmp_path / "chain.yaml", data)
    assert cli.main(["rig", str(path), str(tmp_path / "rig.yaml")]) == 0
    said = capsys.readouterr().out
    if far is None:
        assert "doubts:  none" in said
        return
    assert re.search(
        rf"Fair: 2 cameras, .*doubts:  the cameras stand up to {far} apart", said, re.S
    )
    assert "Check the unit of the positions" in said


def test_a_principal_point_outside_is_refused(tmp_path):
    swapped = stereographic(center=(379.5, 639.5), image_size=(1280, 600))
    with refused(r"rig.yaml: the principal point is \(379.5, 639.5\).*expected inside"):
        loaded(Rig((swapped,) * 4, ring().T_rig_cam), tmp_path)
