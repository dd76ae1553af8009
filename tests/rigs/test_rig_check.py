"""Rig check: every mix-up is named and undone, a moved camera measured; right rigs pass."""

import dataclasses
import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest
import scene
from scipy.spatial.transform import Rotation

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_rigs.doctor import one_camera, rig_check
from omnistereo_rigs.doctor.evidence import Flip, flips
from omnistereo_rigs.doctor.mixups import explain
from omnistereo_rigs.doctor.one_camera import scaled_lens
from omnistereo_rigs.doctor.rig_check import (
    check_rig,
    invert_poses,
    rotate_camera,
    scale_translations,
)
from omnistereo_rigs.images.from_images import relative_poses
from omnistereo_rigs.images.track_bundle import pose_differences

RIG = osl.load_rig(DATA / "sunny" / "test")
QUARTER = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
Z, X = np.diag([1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, 1.0])
# axes of a camera in those of a body, x ahead and z up
ROBOT = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]).T


def quaternions_rolled(pose, by):
    return osl.Pose(
        Rotation.from_quat(np.roll(Rotation.from_matrix(pose.R).as_quat(), by)).as_matrix(), pose.t
    )


def backwards(change):
    """The same mistake in a file of poses rig → camera."""
    return lambda pose: change(pose.inverse()).inverse()


def euler_angles(pose):
    return osl.Pose.from_vector([*Rotation.from_matrix(pose.R).as_euler("xyz"), *pose.t])


MISTAKES = {  # of each pose → what is named
    "inverted": (lambda T: T.inverse(), "the poses look inverted"),
    "R inverted": (lambda T: osl.Pose(T.R.T, T.t), "the rotations look inverted"),
    "R inverted, backwards": (
        backwards(lambda T: osl.Pose(T.R.T, T.t)),
        "the rotations look inverted",
    ),
    "T is the centre": (
        lambda T: osl.Pose(T.R, -T.R @ T.t),
        "the translations look like those of the other direction",
    ),
    "t negated": (lambda T: osl.Pose(T.R, -T.t), "the translations look negated"),
    "OpenGL": (
        lambda T: osl.Pose(T.R @ np.diag([1.0, -1, -1]), T.t),
        "x right, y up, z back, as in OpenGL",
    ),
    "axes of a robot": (
        lambda T: osl.Pose(ROBOT.T @ T.R @ ROBOT, ROBOT.T @ T.t),
        "the camera axes look like x ",
    ),
    "left-handed": (lambda T: osl.Pose(Z @ T.R @ Z, Z @ T.t), "the frame looks left-handed"),
    "mirrored": (lambda T: osl.Pose(X @ T.R @ X, X @ T.t), "all images look mirrored"),
    "w x y z": (
        lambda T: quaternions_rolled(T, 1),
        "the quaternions look like w x y z, read as x y z w",
    ),
    "w x y z, backwards": (
        backwards(lambda T: quaternions_rolled(T, 1)),
        "the quaternions look like w x y z",
    ),
    "x y z w": (
        lambda T: quaternions_rolled(T, -1),
        "the quaternions look like x y z w, read as w x y z",
    ),
    "Euler angles": (euler_angles, "the axis-angle numbers look like angles about x, y and z"),
    "turned images": (
        lambda T: osl.Pose(T.R @ QUARTER @ QUARTER, T.t),
        "all images look turned by 180°",
    ),
    "inverted and OpenGL": (
        lambda T: osl.Pose(T.R @ np.diag([1.0, -1, -1]), T.t).inverse(),
        "the poses look inverted .* and the camera axes look like x right, y up, z back",
    ),
}


def with_noise(pairs, degrees=0.1):
    """Relative poses as images measure them, a little off."""
    rng = np.random.default_rng(0)
    for found in pairs.values():
        turn = osl.Pose.from_vector([*np.radians(degrees) * rng.normal(size=3), 0, 0, 0])
        object.__setattr__(
            found, "T_b_a", osl.Pose(turn.R @ found.T_b_a.R, turn.R @ turn.R @ found.T_b_a.t)
        )
    return pairs


PAIRS = with_noise(relative_poses(RIG))


def named(wrong):
    """Return what is named; undone, the relative poses are those of the true rig."""
    _, found, clear = explain(wrong, PAIRS)
    assert clear
    fixed = relative_poses(found.apply(wrong))
    for key, true in relative_poses(RIG).items():
        np.testing.assert_allclose(fixed[key].T_b_a.R, true.T_b_a.R, atol=1e-6)
        np.testing.assert_allclose(fixed[key].T_b_a.t, true.T_b_a.t, atol=1e-6)
    return found.name


def test_a_right_rig_has_no_mixup():
    given, found, _ = explain(RIG, PAIRS)
    assert found is given and given.name == "" and given.turn_deg < 0.3


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_form_is_named_and_undone(mistake):
    change, name = MISTAKES[mistake]
    assert re.match(f".*{name}", named(RIG.with_poses([change(pose) for pose in RIG.T_rig_cam])))


def test_poses_in_a_chain_are_named():
    chain = [RIG.T_rig_cam[0], *(a.inverse() @ b for a, b in itertools.pairwise(RIG.T_rig_cam))]
    assert named(RIG.with_poses(chain)) == "each pose looks relative to the camera before"


@pytest.mark.parametrize(
    ("order", "give"),
    [((1, 0, 2, 3), "2 1 3 4"), ((1, 2, 3, 0), "2 3 4 1"), ((3, 2, 1, 0), "4 3 2 1")],
)
def test_an_order_is_named(order, give):
    swapped = osl.Rig([RIG.cameras[k] for k in order], [RIG.T_rig_cam[k] for k in order])
    assert named(swapped) == f"the images look swapped (give them in the order {give})"


def test_one_camera_is_named():
    T = RIG.T_rig_cam
    name = named(RIG.with_poses([T[0], osl.Pose(T[1].R.T, T[1].t), *T[2:]]))
    assert name == "of camera 2 alone: the rotations look inverted, the translations do not"
    name = named(rotate_camera(RIG, 2, [0, 0, -np.pi / 2]))
    assert name.startswith("of camera 3 alone: its image looks turned by 90°")


@pytest.mark.parametrize(
    ("degrees", "axis"), [(12, (0, 1, 0)), (12, (0.6, 0.6, -0.5)), (40, (1, 0, 0))]
)
def test_a_turn_by_any_angle_is_no_mixup(degrees, axis):
    assert explain(rotate_camera(RIG, 2, np.radians(degrees) * np.array(axis)), PAIRS)[1] is None


def test_swapped_images_are_named_although_their_lenses_differ():
    """Centres of lenses a degree apart, as in this small world, hide a swap from the pairs."""
    rig = scene.rig(width=200, height=192)
    images = scene.images(rig, finest=0.25)
    found = rig_check.find_mixup(osl.Frame.of(rig, [images[k] for k in (1, 0, 2, 3)]))
    assert found.startswith("the images look swapped (give them in the order 2 1 3 4)")


@pytest.fixture(scope="module")
def frame():
    return osl.load_dataset(DATA / "sunny", split="train")[10]


@pytest.fixture(scope="module")
def street(frame):
    """A rig and the images of a frame, halved: nobody waits for features of 600,000 pixels."""
    small = frame.reduced(1.8)
    return small.rig, [image.round().clip(0, 255).astype(np.uint8) for image in small.images]


def test_a_right_rig_fits_its_images(street):
    rig, images = street
    check = check_rig(rig, images, rig.min_depth)
    assert check.fits
    assert check.text.startswith("the rig fits its images: no camera is off by more than 0.0")


@pytest.mark.parametrize("degrees", [0.4, 12.0])
def test_one_turned_camera_is_measured_and_no_other_is_accused(street, degrees):
    rig, images = street
    check = check_rig(rotate_camera(rig, 2, [0, np.radians(degrees), 0]), images)
    assert check.cause == "turned" and check.cameras == (2,)
    assert check.text.startswith("camera 3 is turned by ") and "(yaw " in check.text
    assert float(check.text.split("turned by ")[1].split("°")[0]) == pytest.approx(
        degrees, abs=0.05 + 0.02 * degrees
    )
    assert np.degrees(np.abs(pose_differences(check.fixed, rig)[:, :3])).max() < 0.1
    for k in (0, 1, 3):  # the innocent stay where the file has them
        np.testing.assert_array_equal(check.fixed.T_rig_cam[k].R, rig.T_rig_cam[k].R)


@pytest.mark.slow
def test_a_camera_far_from_its_place_may_be_late(street):
    rig, images = street
    T = rig.T_rig_cam
    moved = rig.with_poses([*T[:3], osl.Pose(T[3].R, T[3].t + np.array([0.3, 0, 0]))])
    check = check_rig(moved, images)
    assert check.cause == "late or displaced" and check.cameras == (3,) and check.fixed is None
    assert check.text.startswith("camera 4 is late or displaced: ")
    assert "0.3 m ±" in check.text and "give the images before and after" in check.text


@pytest.mark.slow
def test_a_wrong_lens_is_named(street):
    rig, images = street
    cameras = [scaled_lens(c, 1.06) if k == 1 else c for k, c in enumerate(rig.cameras)]
    check = check_rig(dataclasses.replace(rig, cameras=tuple(cameras)), images)
    assert check.cause == "lens" and check.cameras == (1,)
    assert "camera 2" in check.text and "6 % too long" in check.text


PICTURES = {
    "rotated": ({2: Flip(2)}, (0, 1, 2, 3), "image 3 looks turned by 180°"),
    "mirrored": ({0: Flip(0, True)}, (0, 1, 2, 3), "image 1 looks mirrored"),
    "swapped": ({}, (0, 2, 1, 3), "the images look swapped (give them in the order 1 3 2 4)"),
    "swapped and rotated": (
        {3: Flip(2)},
        (3, 1, 2, 0),
        "the images look swapped (give them in the order 4 2 3 1) and image 4 looks turned by 180°",
    ),
}


@pytest.mark.parametrize("cause", PICTURES)
def test_what_was_done_to_pictures_is_named(street, cause):
    done, order, text = PICTURES[cause]
    rig, images = street
    given = [images[k] for k in order]
    for k, flip in done.items():
        given[k] = np.rot90(
            np.fliplr(given[k]) if flip.mirrored else given[k], flip.quarters
        ).copy()
    check = check_rig(rig, given)
    assert check.cause == cause and check.text == text and check.fits is False


def test_a_flip_is_undone_where_a_picture_is_square():
    """What `Flip.undo` says of a pixel, against the picture itself."""
    picture = np.arange(25).reshape(5, 5)
    for flip in flips((5, 5)):
        given = np.fliplr(picture) if flip.mirrored else picture
        given = np.rot90(given, -flip.quarters)
        v, u = np.mgrid[:5, :5]
        x, y = np.moveaxis(flip.undo(np.stack([u, v], -1), (5, 5)), -1, 0).astype(int)
        np.testing.assert_array_equal(picture[y, x], given)


@pytest.mark.slow
def test_a_freed_pose_that_runs_away_is_left_out(monkeypatch):
    """In a flight with a wrong lens a centre was fitted 3e7 m away, which no rig may have."""
    ahead = np.tile([0.0, 0.0, 1.0], (20, 1))
    evidence = SimpleNamespace(rays=lambda *_: (ahead, ahead), counts=lambda _: np.ones((4, 4)))
    monkeypatch.setattr(one_camera, "_fit", lambda start, *_: osl.Pose(start.R, [3e7, 0.0, 0.0]))
    assert all(one.rig is RIG for one in one_camera.free_poses(evidence, RIG, {}))


def test_inverted_poses_are_named_from_images(street):
    rig, images = street
    check = check_rig(invert_poses(rig), images)
    assert not check.fits and check.text.startswith("the poses look inverted")
    assert re.search(r"file and images agree to 0\.[0-4]° in rotation", check.text)
    assert check_rig(check.fixed, images).fits


def test_the_nearest_depth_tells_the_unit(street):
    rig, images = street
    said = check_rig(scale_translations(rig, 1e-3), images, rig.min_depth).text
    assert said.startswith("the translations look 1000 times too short (m read as mm?)")


def test_a_rig_is_not_called_wrong_where_the_images_show_nothing():
    rig = scene.rig(width=200, height=192)
    check = check_rig(rig, [np.full((192, 200), 90, np.uint8)] * 4)
    assert check.fits is None
    assert check.text.startswith("the images do not show whether the rig fits: only 0 matches")


def test_an_image_of_another_moment_may_be_meant():
    """The room stands still, and the rig has turned by 131° between its two frames."""
    now, later = osl.load_dataset(DATA / "indoor" / "test")[:2]
    mixed = osl.Frame.of(now.rig, [*now.images[:3], later.images[3]]).reduced(1.8)
    check = check_rig(mixed.rig, mixed.images)
    assert check.cause == "late or displaced" and check.cameras == (3,)


@pytest.mark.slow
def test_a_camera_two_frames_late_is_named_in_a_street():
    """The matches of the others are held out of its own: it was "turned by 0.81° ± 0.3°"."""
    now, later = (osl.load_dataset(DATA / "drive" / "test")[k] for k in (9, 11))
    mixed = osl.Frame.of(now.rig, [now.images[0], later.images[1], *now.images[2:]]).reduced(1.8)
    check = check_rig(mixed.rig, mixed.images)
    assert check.cause == "late or displaced" and check.cameras == (1,)


@pytest.mark.slow
def test_nobody_is_accused_where_the_others_hardly_agree_either():
    frame = osl.load_dataset(DATA / "rooms" / "test")[3].reduced(1.8)
    check = check_rig(rotate_camera(frame.rig, 1, [0, 0.3, 0]), frame.images)
    assert check.fits is None and check.cause == "cannot tell" and check.cameras == ()
