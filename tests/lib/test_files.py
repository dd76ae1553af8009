"""Files: bad ones are named, writing is atomic."""

import os
import time
from contextlib import nullcontext

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image
from scene import refused

from omnistereo_lib import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder, remove_empty_folders
from omnistereo_lib.pictures import is_whole, read_gray, read_image, write_image

SMOOTH = (
    np.stack(np.meshgrid(np.arange(30), np.arange(20)), -1).astype(np.uint8)[..., [0, 1, 1]] * 4
)
RGB = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)


def test_colour_is_rgb(tmp_path):
    # OpenCV: blue first
    cv2.imwrite(str(tmp_path / "blue.png"), np.full((4, 4, 3), (255, 0, 0), np.uint8))
    assert read_image(tmp_path / "blue.png")[0, 0].tolist() == [0, 0, 255]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif"])
def test_an_image_truncated_anywhere_is_refused_or_complete(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_image(path, RGB)
    whole, content = read_image(path), path.read_bytes()
    for keep in [*range(0, len(content), 41), *range(len(content) - 8, len(content))]:
        path.write_bytes(content[:keep])
        try:
            assert (read_image(path) == whole).all()
        except OmnistereoError as error:
            assert f"a{suffix}" in str(error)


def test_a_jpeg_that_is_damaged_in_the_middle_is_told(tmp_path, capfd):
    """The decoder goes on, and says so where only a terminal would show it."""
    noise = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8)
    write_image(tmp_path / "a.jpg", noise)
    content = bytearray((tmp_path / "a.jpg").read_bytes())
    middle = len(content) // 2
    content[middle : middle + 40] = b"\xff\x00\x12\xff" * 10
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.warns(
        UserWarning, match=r"a.jpg is damaged, so that a part of the picture may be wrong"
    ):
        assert read_image(tmp_path / "a.jpg").shape == (96, 128, 3)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("behind", [bytes(160), b"\xff\xda\xff\xd9film" * 5000, b"\xff\xd9"])
def test_bytes_behind_the_end_of_a_jpeg(tmp_path, behind, recwarn):
    """As embedded cameras pad pictures, and telephones put a film behind; cut off is another."""
    write_image(
        tmp_path / "a.jpg", np.random.default_rng(1).integers(0, 256, (96, 128, 3), np.uint8)
    )
    content, true = (tmp_path / "a.jpg").read_bytes(), read_image(tmp_path / "a.jpg")
    (tmp_path / "b.jpg").write_bytes(content + behind)
    np.testing.assert_array_equal(read_image(tmp_path / "b.jpg"), true)
    assert not recwarn.list
    (tmp_path / "c.jpg").write_bytes(content[:-300] + bytes(160))
    with refused("without the marker of its end"):
        read_image(tmp_path / "c.jpg")


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp", "tiff"])
@pytest.mark.parametrize("orientation", [3, 6])
def test_pixels_are_those_that_are_stored(tmp_path, suffix, orientation):
    """TIFF's tag and EXIF's alike: calibrations refer to the pixels of the sensor."""
    path, exif = tmp_path / f"a.{suffix}", Image.Exif()
    exif[0x0112] = orientation
    lossless = {"lossless": True} if suffix == "webp" else {}
    Image.fromarray(SMOOTH).save(path, exif=exif, **lossless)
    with pytest.warns(
        UserWarning,
        match=rf"a.{suffix} is marked as turned or mirrored \(orientation {orientation}\)",
    ):
        image = read_image(path)
    assert np.abs(image.astype(int) - SMOOTH).max() <= (20 if suffix == "jpg" else 0)


DEEP = np.random.default_rng(1).integers(0, 4096, (48, 64, 3), np.uint16)  # 12 bits in 16


@pytest.mark.parametrize("deep", [DEEP, DEEP[..., 0]], ids=["colour", "gray"])
@pytest.mark.parametrize("form", ["png", "tiff", "turned", "bytes", "text"])
def test_all_of_12_bits_are_read(tmp_path, deep, form):
    """Written by OpenCV, tifffile and by hand; PGM and PPM state what is white."""
    path, head = tmp_path / f"a.{form}", "P{}\n# a comment\n64 48\n4095\n"
    if form == "png":
        cv2.imwrite(str(path), deep[..., ::-1] if deep.ndim == 3 else deep)
    elif form == "bytes":
        path.write_bytes(head.format(deep.ndim + 3).encode() + deep.astype(">u2").tobytes())
    elif form == "text":
        path.write_text(head.format(deep.ndim) + " ".join(map(str, deep.ravel().tolist())))
    else:
        tifffile.imwrite(path, deep, extratags=[(274, 3, 1, 6, True)] if form == "turned" else [])
    with (
        nullcontext()
        if form in ("bytes", "text")
        else pytest.warns(UserWarning, match="uses 12 of its 16 bits")
    ):
        image = read_image(path)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, deep * (255 / 4095), atol=1e-4)


def test_of_16_bits_it_is_said_how_many_are_used_once_for_a_folder(tmp_path):
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), DEEP)
    with pytest.warns(
        UserWarning, match="uses 12 of its 16 bits, so that 4095 is taken as white"
    ) as said:
        for name in ("a.png", "b.png"):
            read_image(tmp_path / name)
    assert len(said) == 1


def test_a_largest_value_other_than_255_is_white(tmp_path):
    (tmp_path / "a.ppm").write_bytes(b"P6 2 1 100\n" + bytes([0, 50, 100, 100, 100, 20]))
    np.testing.assert_allclose(
        read_image(tmp_path / "a.ppm"), [[[0, 127.5, 255], [255, 255, 51]]], rtol=1e-6
    )
    (tmp_path / "a.ppm").write_bytes(b"P6 1 1 100\n" + bytes([0, 50, 101]))
    with refused("a value of 101, where 100 is the largest"):
        read_image(tmp_path / "a.ppm")


@pytest.mark.parametrize(
    ("values", "photometric", "said"),
    [
        (RGB, "cielab", "LAB colours"),
        (np.zeros((20, 30, 4), np.uint8), "separated", "CMYK colours"),
        (np.zeros((20, 30), np.float32), "minisblack", "floating-point numbers"),
        (np.zeros((20, 30, 3), np.float32), "rgb", "values of float32, 20 × 30 × 3"),
    ],
)
def test_other_colour_spaces_are_refused_by_name(tmp_path, values, photometric, said):
    tifffile.imwrite(tmp_path / "a.tiff", values, photometric=photometric)
    with refused(f"a.tiff holds {said}; expected grey or RGB values of 8 or 16 bits"):
        read_image(tmp_path / "a.tiff")


def test_transparency_is_ignored(tmp_path):
    cv2.imwrite(str(tmp_path / "clear.png"), np.full((4, 4, 4), (1, 2, 3, 0), np.uint8))
    with pytest.warns(UserWarning, match="clear.png has transparency, which is ignored"):
        assert read_image(tmp_path / "clear.png")[0, 0].tolist() == [3, 2, 1]


@pytest.mark.parametrize(
    ("pages", "said"), [(2, "1 more page, which is"), (3, "2 more pages, which are")]
)
def test_further_pages_are_ignored(tmp_path, pages, said):
    tifffile.imwrite(
        tmp_path / "a.tiff", np.zeros((pages, 20, 30), np.uint8), photometric="minisblack"
    )
    with pytest.warns(UserWarning, match=f"a.tiff has {said} ignored$"):
        assert read_image(tmp_path / "a.tiff").shape == (20, 30)


def test_a_mask_is_read_as_gray(tmp_path):
    write_image(tmp_path / "mask.png", RGB)
    np.testing.assert_array_equal(read_gray(tmp_path / "mask.png", (30, 20)), RGB.max(-1))


def test_the_old_file_stays_when_writing_fails(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_write(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["result.txt"]
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_what_killed_processes_have_left_is_removed_after_an_hour(tmp_path):
    left = f".{'0a' * 8}.[a].txt"
    others = [f".{'0a' * 8}.b.txt", f"{left}.bak", left[1:], ".x.[a].txt", ".[a].txt"]
    for name in [*others, left]:
        (tmp_path / name).write_text("left")
    for age, expected in ((-9000, {*others, left}), (99, {*others, left}), (4000, {*others})):
        for name in [*others, left]:
            os.utime(tmp_path / name, (time.time() - age,) * 2)
        with atomic_write(tmp_path / "[a].txt") as temporary:
            temporary.write_text("new")
        assert {path.name for path in tmp_path.iterdir()} == {"[a].txt", *expected}


def test_a_clock_that_is_wrong_does_not_take_another_writers_file(tmp_path, monkeypatch):
    """As of a machine whose clock is a day ahead, in a folder that it shares."""
    monkeypatch.setattr(time, "time", lambda now=time.time: now() + 86400)
    with atomic_write(tmp_path / "a.txt") as first:
        first.write_text("first")
        with atomic_write(tmp_path / "a.txt") as second:
            second.write_text("second")
    assert (tmp_path / "a.txt").read_text() == "first"


def test_folders_without_a_file_go_and_others_stay(tmp_path):
    make_folder(tmp_path / "a" / "b" / "c")
    (make_folder(tmp_path / "a" / "d") / "file").write_text("")
    (tmp_path / "theirs").mkdir()
    make_folder(tmp_path / "theirs")
    remove_empty_folders()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "d", "file", "theirs"]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff"])
def test_a_torn_picture_is_not_whole(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    assert not is_whole(path)
    write_image(path, RGB)
    assert is_whole(path)
    for keep in (300, 0):
        path.write_bytes(path.read_bytes()[:keep])
        assert not is_whole(path)


def test_writing_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("old")
    for path in (tmp_path / "missing" / "a.png", tmp_path / "file" / "a.png"):
        with refused(r"a.png cannot be written: .*Give a file in an existing"):
            write_image(path, RGB)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "old"


@pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="the superuser may write anywhere"
)
def test_a_folder_that_is_not_writable(tmp_path):
    tmp_path.chmod(0o500)
    with refused("written to: Permission denied"):
        make_folder(tmp_path)


def test_a_hole_in_a_deflated_tiff_is_damage_and_nothing_is_printed(tmp_path, capfd):
    rng, path = np.random.default_rng(0), tmp_path / "a.tiff"
    pixels = rng.integers(0, 40, (60, 80, 3)).astype(np.uint8)
    tifffile.imwrite(path, pixels, compression="deflate", photometric="rgb")
    np.testing.assert_array_equal(read_image(path), pixels)
    content = path.read_bytes()
    for place in rng.integers(600, len(content) - 40, 40):
        path.write_bytes(content[:place] + bytes(32) + content[place + 32 :])
        with refused("is damaged"):
            read_image(path)
    assert capfd.readouterr() == ("", "")
