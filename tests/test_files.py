"""Files: bad ones are named, half-written ones never stay."""

import os

import cv2
import numpy as np
import pytest

from omnistereo_lib import OmnistereoError
from omnistereo_lib.files import make_folder, read_image, replacing, write_image

RGB = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)


@pytest.mark.parametrize("picture", [RGB, RGB[..., 0]], ids=["colour", "gray"])
def test_pictures_come_back(tmp_path, picture):
    write_image(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), picture)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_colour_is_rgb(tmp_path):
    cv2.imwrite(str(tmp_path / "blue.png"), np.full((4, 4, 3), (255, 0, 0), np.uint8))  # OpenCV: blue first
    assert read_image(tmp_path / "blue.png")[0, 0].tolist() == [0, 0, 255]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0.1, 0.5, 0.95])
def test_pictures_cut_short_are_refused(tmp_path, suffix, keep):
    path = tmp_path / f"a{suffix}"
    write_image(path, np.tile(RGB, (10, 10, 1)))
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(OmnistereoError, match=rf"a{suffix} is cut short: {int(keep * len(content))} bytes"):
        read_image(path)


def test_what_is_no_picture_is_refused(tmp_path):
    (tmp_path / "a.png").write_text("hello")
    with pytest.raises(OmnistereoError, match=r"a.png holds no picture, 5 bytes"):
        read_image(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(OmnistereoError, match=r"holds no picture, 0 bytes"):
        read_image(tmp_path / "a.png")
    with pytest.raises(OmnistereoError, match=r"b.png cannot be read: No such file"):
        read_image(tmp_path / "b.png")


def test_the_old_file_stays_when_writing_fails(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and [path.name for path in tmp_path.iterdir()] == ["result.txt"]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_folders(tmp_path):
    assert make_folder(tmp_path / "a" / "b").is_dir()
    assert list(make_folder(tmp_path / "a" / "b").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(OmnistereoError, match=r"folder .*file.* cannot be made"):
        make_folder(tmp_path / "file" / "c")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_that_is_not_writable(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OmnistereoError, match="cannot be written: Permission denied"):
        make_folder(tmp_path)
