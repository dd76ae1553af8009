"""Cameras that show another moment than the rest; `workshop late-table` scores them on drives."""

import re

import numpy as np
import pytest

import omnistereo_lib as osl
from omnistereo_learn.evaluate.run import DATA
from omnistereo_rigs.images.late import LateCameras
from omnistereo_tools.record import sync
from omnistereo_tools.record.sync import check_moments, is_on_time, is_sure, measure_late


@pytest.fixture(scope="module")
def drive():
    return osl.load_dataset(DATA / "drive" / "test")


@pytest.fixture(scope="module")
def features(drive):
    """Of the first six frames, found once."""
    return LateCameras(drive.rig, [drive[k].images for k in range(6)])._features


def look(drive, features, slots):
    """What four frames show whose cameras are of given frames: slots[frame][camera]."""
    looks = LateCameras(drive.rig, slots)
    looks._features = lambda frame, camera: features(slots[frame][camera], camera)
    return looks.find(reach=2)


@pytest.mark.slow
@pytest.mark.parametrize("late", [(0, 0, 0, 0), (0, 0, 1, 0), (0, 2, 1, 0)])
def test_any_number_of_late_cameras_is_found(drive, features, late):
    found = look(drive, features, [[k + 2 - own for own in late] for k in range(4)])
    np.testing.assert_allclose(found.frames, late, atol=1e-9)
    assert found.clear > 1.4 and found.matches > 40
    assert (found.gain > 1.4) if any(late) else (found.gain == 1)


@pytest.mark.slow
def test_a_rig_that_stands_still_is_not_clear(drive, features):
    found = look(drive, features, [[2] * 4] * 4)
    assert found.clear < 1.05


def test_images_without_a_match_show_nothing(drive):
    """Not even how the cameras differ; nothing is divided by their number."""
    rng = np.random.default_rng(0)
    w, h = drive.rig.cameras[0].image_size
    noise = rng.integers(0, 255, (2, 4, h // 4, w // 4), np.uint8).repeat(4, 2).repeat(4, 3)
    images = [[np.resize(image, (h, w)) for image in row] for row in noise]
    found = LateCameras(drive.rig, images).find(reach=1)
    assert not is_sure(found) and not is_on_time(found)


@pytest.mark.slow
def test_half_a_frame_is_measured(drive):
    """Every second frame of a drive, and between these what camera 3 saw."""
    slots = [[k, k, k - 1, k] for k in range(1, 16, 2)]
    images = [[drive[t].images[c] for c, t in enumerate(row)] for row in slots]
    late = sync._measure(drive.rig, images)
    np.testing.assert_allclose(late, (0, 0, 0.5, 0), atol=0.15)


def laid_out(drive, folder, late, frames):
    """Folders of pictures named by time, ten a second, in which cameras are late by some frames."""
    for camera, own in enumerate(late):
        (folder / f"cam{camera + 1}").mkdir()
        source = sorted((DATA / "drive" / "test" / f"cam{camera + 1}").iterdir())
        for k in range(frames):
            name = f"{1700000000000 + 100 * k}.jpg"
            (folder / f"cam{camera + 1}" / name).symlink_to(source[k + 2 - own])
    return [folder / f"cam{camera + 1}" for camera in range(len(late))]


@pytest.mark.nightly
def test_record_names_a_late_camera_and_sync_measures_it(drive, tmp_path, capsys):
    paths = laid_out(drive, tmp_path, (0, 0, 1, 0), 10)
    said, open_ = check_moments(paths, drive.rig, [])
    assert re.fullmatch(r"camera 3 is one frame late \((99|100|101) ms\)", said) and open_ is None
    late = np.array(measure_late(paths, drive.rig, [])) / 1e8
    np.testing.assert_allclose(late, (0, 0, 1, 0), atol=0.1)
    assert "camera 3 is one frame late (10" in capsys.readouterr().err
    assert check_moments(paths, drive.rig, (1e8 * late).round().astype(int)) == (None, None)
