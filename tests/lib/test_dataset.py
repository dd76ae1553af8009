"""Data sets: the public layout with its traps, both encodings of the ground truth, all errors."""

import copy
import shutil
import weakref
from dataclasses import replace

import cv2
import numpy as np
import pytest
import scene
import tifffile
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.frame import Frame, read_inverse_depth, write_inverse_depth
from omnistereo_lib.pictures import write_image

RIG = scene.rig(width=40, height=32)
GT = np.random.default_rng(0).uniform(0, 1 / 0.55, (8, 32)).astype(np.float32)  # ±45°


def save(folder, numbers, digits=4, rig=RIG, cameras=4, gt="omnidepth_gt_32"):
    """Write a data set; each image holds the numbers of its camera and frame."""
    folder.mkdir(parents=True, exist_ok=True)
    osl.save_rig(rig, folder / "config.yaml")
    for k in range(1, cameras + 1):
        (folder / f"cam{k}").mkdir(exist_ok=True)
        for number in numbers:
            image = np.full((32, 40), (10 * k + number) % 256, np.uint8)
            write_image(folder / f"cam{k}" / f"{number:0{digits}}.png", image)
    if gt:
        (folder / gt).mkdir(parents=True, exist_ok=True)
        for number in numbers:
            write_inverse_depth(folder / gt / f"{number:05}.tiff", GT + number)
    return folder


def numbers(folder, split=None):
    return [frame.number for frame in osl.load_dataset(folder, split)]


def refuses(message, folder, *arguments, **options):
    with refused(message):
        osl.load_dataset(folder, *arguments, **options)


def test_the_public_layout(tmp_path):
    data = osl.load_dataset(save(tmp_path, [1, 2, 17]))
    assert len(data) == 3 and len(data.rig) == 4
    holds = "3 frames, 3 with ground truth, 4 cameras of 40 × 32"
    assert repr(data) == f"Dataset({tmp_path.name}: {holds})"
    frame = data[1]
    assert frame.number == 2 and [image[0, 0] for image in frame.images] == [12, 22, 32, 42]
    np.testing.assert_array_equal(frame.inverse_depth, GT + 2)
    assert [f.number for f in data] == [1, 2, 17] and data[-1].number == 17
    assert [f.number for f in data[1:]] == [2, 17] and len(data[1:]) == 2
    assert data.frame(17).number == 17
    with refused("has no frame 5; expected one of 1, 2, 17"):
        data.frame(5)


def test_images_are_read_on_first_use_and_not_kept(tmp_path):
    data = osl.load_dataset(save(tmp_path, [1, 2]))
    (tmp_path / "cam3" / "0002.png").write_bytes(b"")
    frame = data[0]
    assert frame.images[0] is frame.images[0]  # read once
    image = weakref.ref(frame.images[0])
    del frame
    assert image() is None  # a loop over a thousand frames holds one
    with refused(r"cam3.0002.png is not an image"):
        data[1].images


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    rig = scene.rig(width=40, height=32, cameras=11)
    save(tmp_path, [1], rig=rig, cameras=11)
    (tmp_path / "cam5").rename(tmp_path / "cam05")
    for name in ("cam1_2", "cam3²", "cam4.old", "cameras"):  # not camera folders
        (tmp_path / name).mkdir()
    (tmp_path / "cam12").write_text("")
    assert [int(image[0, 0]) for image in osl.load_dataset(tmp_path)[0].images] == [
        10 * k + 1 for k in range(1, 12)
    ]
    (tmp_path / "cam5").mkdir()
    refuses(r"cam05 and .*cam5 have the same number", tmp_path)


def test_misnamed_frames_of_omnithings(tmp_path):
    save(tmp_path, [1, 2, 3, 4], digits=5)
    for k in (2, 3, 4):
        for number in (1, 2, 3):
            (tmp_path / f"cam{k}" / f"{number:05}.png").rename(
                tmp_path / f"cam{k}" / f"{number:04}.png"
            )
    assert numbers(tmp_path) == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("cam2/0001.jpg", "cam2/0001.png"),
        ("cam2/0001.png", "cam2/1.png"),
        ("omnidepth_gt_32/00001.png", "omnidepth_gt_32/00001.tiff"),
        ("depth_train_32/00001.tiff", "omnidepth_gt_32/00001.tiff"),
    ],
)
def test_two_files_of_one_frame_are_named(tmp_path, first, second):
    save(tmp_path, [1])
    for name in (first, second):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    refuses(f"{first} and .*{second} have the same number", tmp_path)


def test_other_files_beside_the_frames(tmp_path):
    save(tmp_path, [1])
    for name in ("mask.png", "0002.txt", "².png", "0003.png.part", ".1.0004.png"):
        (tmp_path / "cam1" / name).write_text("")
    for name in ("depth_2", "omnidepth_gt_²"):
        (tmp_path / name).write_text("")
    assert numbers(tmp_path) == [1]


def test_a_frame_that_one_camera_lacks(tmp_path):
    save(tmp_path, [1, 2])
    (tmp_path / "cam3" / "0002.png").unlink()
    refuses(r"cam3 has no image of frame 2, other cameras have", tmp_path)


def test_what_is_missing_is_named(tmp_path):
    refuses("empty", tmp_path / "empty")
    refuses(r"has no frames; expected cam1.0001.png", save(tmp_path / "no_frames", []))
    three = save(tmp_path / "three", [1], cameras=3)
    refuses(r"camera folders cam1, cam2, cam3; expected cam1 to cam4", three)
    data = osl.load_dataset(save(tmp_path / "no_gt", [7], gt=None))
    assert data[0].gt_path is None
    with refused("frame 7 has no ground truth"):
        data[0].inverse_depth


def test_the_widest_ground_truth_or_the_one_asked_for(tmp_path):
    save(tmp_path, [1], gt="omnidepth_gt_32")
    save(tmp_path, [1], gt="omnidepth_gt_640")
    (tmp_path / "omnidepth_gt_1200").mkdir()  # empty
    assert osl.load_dataset(tmp_path)[0].gt_path.parent.name == "omnidepth_gt_640"
    assert osl.load_dataset(tmp_path, gt_width=32)[0].gt_path.parent.name == "omnidepth_gt_32"
    refuses(r"no ground truth of width 1200; expected one of \[32, 640\]", tmp_path, gt_width=1200)


def test_splits_in_folders(tmp_path):
    save(tmp_path / "train", [1, 2])
    save(tmp_path / "test", [3])
    assert numbers(tmp_path, "train") == [1, 2] and numbers(tmp_path, "test") == [3]


def test_published_splits_by_number(tmp_path):
    sunny = save(tmp_path / "Sunny", [1, 700, 701, 1000, 1001], gt=None)
    assert numbers(sunny, "train") == [1, 700]
    assert numbers(sunny, "test") == [701, 1000]
    assert len(numbers(sunny)) == 5
    refuses(r"has no split 'validation'", sunny, "validation")
    refuses(r"mine has no split 'test'.* sunny, cloudy", save(tmp_path / "mine", [1]), "test")
    refuses("has no frames of split test", save(tmp_path / "cloudy", [1]), "test")


def test_the_first_release_keeps_one_ground_truth_for_all_weathers(tmp_path):
    sunny = save(tmp_path / "sunny", [1, 701], gt=None)
    for split, number in (("train", 1), ("test", 701)):
        (tmp_path / f"depth_{split}_32").mkdir()
        write_inverse_depth(tmp_path / f"depth_{split}_32" / f"{number:04}.tiff", GT)
    paths = [frame.gt_path for frame in osl.load_dataset(sunny)]
    assert [path.parent.name for path in paths] == ["depth_train_32", "depth_test_32"]


def test_a_set_in_another_light_points_to_the_ground_truth_of_its_drive(tmp_path):
    sunny = save(tmp_path / "sunny", [1])
    cloudy = save(tmp_path / "cloudy", [1], gt=None)
    config = cloudy / "config.yaml"
    config.write_text(config.read_text().replace("dataset: {", "dataset: {truth: ../sunny, "))
    assert osl.load_dataset(cloudy)[0].gt_path.samefile(osl.load_dataset(sunny)[0].gt_path)
    for outside in ("/etc", "../../.."):
        other = cloudy / "config.yaml"
        other.write_text(config.read_text().replace("../sunny", outside))
        refuses(r"config.yaml names '.*'; expected a path below", cloudy)
        other.write_text(config.read_text().replace(outside, "../sunny"))
    sunny.rename(tmp_path / "away")
    refuses(r"names .*sunny as the ground-truth folder; there is no such folder", cloudy)


def test_where_the_ground_truth_is_survives_other_encodings_and_names_a_broken_file(tmp_path):
    config = save(tmp_path, [1]) / "config.yaml"
    whole = config.read_bytes()
    config.write_bytes(b"%YAML:1.0\n# gemessen in M\xfcnchen, truth: exact\n" + whole)
    assert osl.load_dataset(tmp_path)[0].gt_path is not None
    config.write_bytes(whole + b"dataset: {truth: [\n")
    refuses(r"config\.yaml: not valid JSON or YAML", tmp_path)


# ---- a rig for each frame


def save_worlds(folder, cameras=(3, 5, 4)):
    """Frames 1, 2, … in folders of their own; the min_depth of a rig is the frame's number."""
    for number, count in enumerate(cameras, start=1):
        rig = scene.rig(width=40, height=32, cameras=count)
        rig = osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=float(number))
        save(folder / f"{number:04}", [number], rig=rig, cameras=count, gt=None)
        path = folder / f"{number:04}" / "omnidepth_gt_2" / f"{number:05}.png"
        path.parent.mkdir()
        cv2.imwrite(str(path), np.array([[0, 65500]], np.uint16))
    return folder


def test_frames_that_have_their_own_rigs(tmp_path):
    save_worlds(tmp_path / "things" / "train")
    (tmp_path / "things" / "train" / ".0004").mkdir()  # of a renderer that is at work
    data = osl.load_dataset(tmp_path / "things", "train")
    assert repr(data) == "Dataset(train: 3 frames, 3 with ground truth, a rig for each frame)"
    counts = [(frame.number, len(frame.rig), len(frame.images)) for frame in data]
    assert counts == [(1, 3, 3), (2, 5, 5), (3, 4, 4)]
    for frame in data[1:]:
        # in steps of its own nearest depth
        np.testing.assert_allclose(frame.inverse_depth, [[0, 1 / frame.number]])
    assert [int(image[0, 0]) for image in data.frame(2).images] == [12, 22, 32, 42, 52]
    for part in (data, data[:1]):
        with refused(r"train has a rig for each frame; expected one rig. Use frame"):
            part.rig


def test_the_frame_of_the_file_is_kept_for_every_rig(tmp_path):
    tilted = scene.rig(width=40, height=32).transformed(osl.Pose.from_vector([1.0, 0, 0, 0, 0, 0]))
    tilted = osl.Rig(tilted.cameras, tilted.T_rig_cam)  # as of a file that says nothing of it
    save(tmp_path / "0001", [1], rig=tilted, cameras=4, gt=None)
    found = osl.load_dataset(tmp_path)[0].rig
    assert np.allclose(found.T_rig_cam[0].R, tilted.T_rig_cam[0].R)


def test_frames_of_an_ordinary_set_carry_its_rig(tmp_path):
    (save(tmp_path, [1, 2]) / "0001").mkdir()  # beside camera folders it is no frame
    data = osl.load_dataset(tmp_path)
    assert len(data) == 2 and all(frame.rig is data.rig for frame in data)


def test_errors_in_frames_that_have_their_own_rigs(tmp_path):
    refuses("worlds has no split 'validation'", save_worlds(tmp_path / "worlds"), "validation")
    (tmp_path / "worlds" / "0002" / "config.yaml").unlink()
    refuses("0002", tmp_path / "worlds")
    save_worlds(tmp_path / "twice")
    (tmp_path / "twice" / "0003").rename(tmp_path / "twice" / "0004")
    save(tmp_path / "twice" / "0003", [2])
    refuses("twice has two frames of one number; expected different numbers", tmp_path / "twice")


# ---- files of ground truth


def test_float_tiff_comes_back(tmp_path):
    gt = GT.copy()
    gt[0, :4] = [np.nan, np.inf, -1, 0]
    write_inverse_depth(tmp_path / "a.tiff", gt)
    read = read_inverse_depth(tmp_path / "a.tiff")
    assert np.isnan(read[0, :3]).all() and read[0, 3] == 0 and read.dtype == np.float32
    np.testing.assert_array_equal(read[1:], gt[1:])
    assert [path.name for path in tmp_path.iterdir()] == ["a.tiff"]


def test_the_float_page_behind_a_thumbnail(tmp_path):
    """The current releases: OpenCV and PIL show the thumbnail and lose the depth."""
    with tifffile.TiffWriter(tmp_path / "a.tiff") as tiff:
        tiff.write(np.zeros((4, 16, 3), np.uint8), photometric="rgb")
        tiff.write(GT)
    np.testing.assert_array_equal(read_inverse_depth(tmp_path / "a.tiff"), GT)


def test_png_counts_in_steps_of_the_nearest_depth(tmp_path):
    save(tmp_path, [1], rig=osl.Rig(RIG.cameras, RIG.T_rig_cam, min_depth=0.5), gt=None)
    path = tmp_path / "depth_test_3" / "00001.png"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.array([[0, 655, 65500]], np.uint16))
    np.testing.assert_allclose(
        osl.load_dataset(tmp_path)[0].inverse_depth, [[0, 1 / 50, 1 / 0.5]], rtol=1e-6
    )
    with refused("in units of 1/min_depth"):
        read_inverse_depth(path)


def test_ground_truth_of_another_kind(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((4, 8), np.uint8))
    with refused(r"uint8 of shape \(4, 8\); expected 16-bit grey"):
        read_inverse_depth(tmp_path / "a.png", 0.5)
    tifffile.imwrite(tmp_path / "a.tiff", np.zeros((4, 8, 3), np.uint8), photometric="rgb")
    with refused("has 0 float pages; expected one"):
        read_inverse_depth(tmp_path / "a.tiff")


def test_a_tiff_truncated_anywhere_is_refused(tmp_path):
    write_inverse_depth(tmp_path / "whole.tiff", GT)
    content = (tmp_path / "whole.tiff").read_bytes()
    for keep in range(0, len(content), 37):
        (tmp_path / "a.tiff").write_bytes(content[:keep])
        try:
            np.testing.assert_array_equal(read_inverse_depth(tmp_path / "a.tiff"), GT)
        except osl.OmnistereoError:
            continue


def test_a_hole_of_zeros_in_a_depth_file_is_never_read_as_whole(tmp_path):
    """Also where it takes the checksum away; what is read is what was written."""
    rng, file = np.random.default_rng(0), tmp_path / "a.tiff"
    gt = (np.cumsum(rng.normal(0, 0.01, (24, 96)), axis=1) ** 2).astype(np.float32)
    write_inverse_depth(file, gt)
    content, refused = file.read_bytes(), 0
    for place in [*range(0, 420, 3), *rng.integers(0, len(content), 260)]:
        damaged = bytearray(content)
        damaged[place : place + rng.choice([4, 12, 64, 512, 4096])] = b""
        damaged[place:place] = bytes(len(content) - len(damaged))
        file.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(read_inverse_depth(file), gt)
        except osl.OmnistereoError:
            refused += 1
    assert refused > 300


def test_depth_that_another_program_has_written_is_read(tmp_path):
    for name, options in {
        "plain": {},
        "deflated": {"compression": "deflate"},
        "described": {"description": "x"},
    }.items():
        tifffile.imwrite(tmp_path / f"{name}.tiff", GT, **options)
        np.testing.assert_array_equal(read_inverse_depth(tmp_path / f"{name}.tiff"), GT)


# ---- ground-truth index


BAND = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7)


def gt_index(tmp_path, inverse_depth, grid):
    write_inverse_depth(tmp_path / "gt.tiff", inverse_depth)
    return Frame(RIG, gt_path=tmp_path / "gt.tiff").gt_index(grid)


def gt_of(grid):
    """The inverse depth of the closed-form world on a grid."""
    return 1 / scene.distance(np.zeros(3), grid.rays())


@pytest.mark.parametrize("sampling", ["center", "sweepnet", "omnimvs"])
def test_gt_index_on_the_grid_of_the_ground_truth_is_exact(tmp_path, sampling):
    grid = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7, sampling=sampling)
    inverse_depth = gt_of(grid).astype(np.float32)
    inverse_depth[3, 5] = np.nan
    index = gt_index(tmp_path, inverse_depth, grid)
    # NaN stays NaN
    np.testing.assert_allclose(index, inverse_depth.astype(np.float64) * 0.7 * 47, rtol=1e-15)


def test_gt_index_takes_the_nearest_ray_of_another_size(tmp_path):
    # every third of its pixel centres is one of the band
    fine = osl.SphereGrid(192, 48, (-45, 45), 48, 0.7)
    index = gt_index(tmp_path, gt_of(fine), BAND)
    np.testing.assert_allclose(index, BAND.inverse_depth_to_index(gt_of(BAND)), rtol=1e-6)


def test_gt_index_of_a_full_sphere_on_a_band_and_back(tmp_path):
    """640 × 320 reaches from pole to pole: a band of ±45° takes its middle half."""
    full = osl.SphereGrid(64, 32, (-90, 90), 48, 0.7)
    expected = BAND.inverse_depth_to_index(gt_of(BAND))
    np.testing.assert_allclose(gt_index(tmp_path, gt_of(full), BAND), expected, rtol=1e-6)
    index = gt_index(tmp_path, gt_of(BAND), full)
    assert np.isnan(index[:8]).all() and np.isnan(index[24:]).all()
    np.testing.assert_allclose(index[8:24], expected, rtol=1e-6)


def test_a_set_that_lies_packed_is_unpacked_when_it_is_read(tmp_path):
    save(tmp_path / "city" / "test", [1, 2])
    shutil.make_archive(tmp_path / "city", "zip", tmp_path, "city")
    shutil.rmtree(tmp_path / "city")
    assert len(osl.load_dataset(tmp_path / "city", "test")) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["city", "city.zip"]


def test_a_damaged_archive_is_named(tmp_path):
    (tmp_path / "city.zip").write_bytes(b"PK")
    refuses(r"city.zip cannot be unpacked: .*make doctor", tmp_path / "city" / "test")
    assert [path.name for path in tmp_path.iterdir()] == ["city.zip"]


def test_a_frame_keeps_what_follows_from_its_images():
    rig = scene.rig()
    images = [np.round(np.stack([i, 0.9 * i, i], -1)).astype(np.uint8) for i in scene.images(rig)]
    frame = osl.Frame.of(rig, images)
    assert osl.Frame.of(rig.recentered(), frame) is frame and frame.gray is frame.gray
    other = osl.Frame.of(replace(rig, cameras=[replace(c) for c in rig.cameras]), frame)
    assert other is not frame and other.rig is not rig  # its cameras may be others
    small = frame.reduced(frame.images[0].shape[1] / rig.cameras[0].max_fov_deg / 3.2)
    assert frame.reduced(1e3) is frame and small.rig.cameras[0] is rig.cameras[0].reduced(3)
    height, width = (side // 3 for side in images[0].shape[:2])
    blocks = images[0][: 3 * height, : 3 * width].reshape(height, 3, width, 3, 3).mean((1, 3))
    np.testing.assert_allclose(small.images[0], blocks, atol=0.51)
    copied = copy.copy(frame)
    assert "gray" not in copied.__dict__ and np.array_equal(copied.images[0], images[0])
