"""Two lenses in one image, and panoramas, which are refused with the reason."""

import warnings

import cv2
import numpy as np
import pytest
import scene
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.consumer_images import is_equirectangular
from omnistereo_tools.judge.first_look import picture_doubt

BACK = osl.Pose.from_vector([0, np.pi, 0, 0, 0, -0.03])


@pytest.fixture(scope="module")
def two():
    rig = osl.Rig((scene.camera(200, 192, 200),) * 2, (osl.Pose.identity(), BACK))
    return rig, [image.clip(0, 255).astype(np.uint8) for image in scene.images(rig, finest=0.25)]


@pytest.mark.parametrize("axis", [0, 1])
def test_one_image_with_the_circles_beside_or_above_each_other(two, tmp_path, axis):
    rig, images = two
    cv2.imwrite(str(tmp_path / "dual.png"), np.concatenate(images, axis))
    for ours, theirs in zip(osl.load_images([tmp_path / "dual.png"], rig), images, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_one_image_that_both_cameras_describe(two, tmp_path):
    """Principal points in the two halves of one image are plausible, and no copy."""
    rig, images = two
    shared = [scene.camera(400, 192, 200, shift=(shift, 0.0)) for shift in (-100, 100)]
    assert abs(shared[1].center[0] - shared[0].center[0] - 200) < 1
    osl.save_rig(osl.Rig(shared, rig.T_rig_cam), tmp_path / "rig.yaml")
    cv2.imwrite(str(tmp_path / "dual.png"), np.hstack(images))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = osl.load_rig(tmp_path / "rig.yaml")
    pictures = osl.load_images([tmp_path / "dual.png"], loaded)
    assert len(pictures) == 2 and picture_doubt(pictures) is None
    assert picture_doubt([pictures[0], pictures[0].copy()])


def test_other_single_images_are_refused(two, tmp_path):
    cv2.imwrite(str(tmp_path / "one.png"), two[1][0])
    with refused(r"one.png is one image of 200 × 192 px for 2 cameras.*side by side"):
        osl.load_images([tmp_path / "one.png"], two[0])


def test_panoramas_are_recognised(two, tmp_path):
    height, width = 300, 600
    theta, phi = np.meshgrid(
        np.linspace(-np.pi, np.pi, width), np.linspace(-np.pi / 2, np.pi / 2, height)
    )
    around = 60 * np.sin(3 * theta) + 30 * np.cos(theta)
    sky = 120 + around * np.cos(phi) + 40 * np.sin(phi)
    panorama = sky.clip(0, 255).astype(np.uint8)
    assert is_equirectangular(panorama) and is_equirectangular(np.stack([panorama] * 3, -1))
    assert not is_equirectangular(np.hstack(two[1]))  # two circles
    assert not is_equirectangular(panorama[:, : width // 2])  # not 2 to 1
    assert not is_equirectangular(
        np.hstack([np.tile(np.arange(128, dtype=np.uint8), (128, 1))] * 2)
    )
    cv2.imwrite(str(tmp_path / "pano.jpg"), panorama)
    with refused(r"pano.jpg looks like an equirectangular .* one point, .* needs two"):
        osl.load_images([tmp_path / "pano.jpg"], two[0])


def test_files_of_360_cameras_are_refused_by_name(two, tmp_path):
    with refused(r"GS01.360 is a panorama of a 360° camera. .* needs two"):
        osl.load_images([tmp_path / "GS01.360"], two[0])
