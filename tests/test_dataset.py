"""Data sets: the public layout with its traps, both encodings of the ground truth, all errors."""

import weakref

import cv2
import numpy as np
import pytest
import scene
import tifffile

import omnistereo_lib as osl
from omnistereo_lib.dataset import Frame, read_inverse_depth, write_inverse_depth
from omnistereo_lib.files import write_image

RIG = scene.rig(width=40, height=32)
TRUTH = np.random.default_rng(0).uniform(0, 1 / 0.55, (8, 32)).astype(np.float32)  # ±45°


def save(folder, numbers, digits=4, rig=RIG, cameras=4, truth="omnidepth_gt_32"):
    """Write a data set of the public layout; each image holds its camera's and frame's number."""
    folder.mkdir(parents=True, exist_ok=True)
    rig.save(folder / "config.yaml")
    for k in range(1, cameras + 1):
        (folder / f"cam{k}").mkdir(exist_ok=True)
        for number in numbers:
            write_image(
                folder / f"cam{k}" / f"{number:0{digits}}.png", np.full((32, 40), (10 * k + number) % 256, np.uint8)
            )
    if truth:
        (folder / truth).mkdir(parents=True, exist_ok=True)
        for number in numbers:
            write_inverse_depth(folder / truth / f"{number:05}.tiff", TRUTH + number)
    return folder


def test_the_public_layout(tmp_path):
    data = osl.load_dataset(save(tmp_path, [1, 2, 3]))
    assert len(data) == 3 and len(data.rig) == 4
    assert repr(data) == f"Dataset({tmp_path.name}: 3 frames, 3 with ground truth, 4 cameras of 40 × 32)"
    frame = data[1]
    assert frame.number == 2 and [image[0, 0] for image in frame.images] == [12, 22, 32, 42]
    np.testing.assert_array_equal(frame.inverse_depth, TRUTH + 2)
    assert [f.number for f in data] == [1, 2, 3] and data[-1].number == 3
    assert [f.number for f in data[1:]] == [2, 3] and len(data[1:]) == 2


def test_images_are_read_when_asked_for_and_not_kept(tmp_path):
    data = osl.load_dataset(save(tmp_path, [1, 2]))
    (tmp_path / "cam3" / "0002.png").write_bytes(b"")
    frame = data[0]
    assert frame.images[0] is frame.images[0]  # read once
    image = weakref.ref(frame.images[0])
    del frame
    assert image() is None  # a loop over a thousand frames holds one
    with pytest.raises(osl.OmnistereoError, match=r"cam3.0002.png holds no picture, 0 bytes"):
        data[1].images


def test_cameras_are_in_the_order_of_their_numbers(tmp_path):
    rig = scene.rig(width=40, height=32, cameras=11)
    data = osl.load_dataset(save(tmp_path, [1], rig=rig, cameras=11))
    assert [int(image[0, 0]) for image in data[0].images] == [10 * k + 1 for k in range(1, 12)]


def test_misnamed_frames_of_omnithings(tmp_path):
    save(tmp_path, [1, 2, 3, 4], digits=5)
    for k in (2, 3, 4):
        for number in (1, 2, 3):
            (tmp_path / f"cam{k}" / f"{number:05}.png").rename(tmp_path / f"cam{k}" / f"{number:04}.png")
    assert [frame.number for frame in osl.load_dataset(tmp_path)] == [1, 2, 3, 4]


def test_other_files_beside_the_frames(tmp_path):
    save(tmp_path, [1])
    (tmp_path / "cam1" / "mask.png").write_text("")
    (tmp_path / "cam1" / "0002.txt").write_text("")
    (tmp_path / "cameras").mkdir()
    assert len(osl.load_dataset(tmp_path)) == 1


def test_a_frame_that_one_camera_lacks(tmp_path):
    save(tmp_path, [1, 2])
    (tmp_path / "cam3" / "0002.png").unlink()
    with pytest.raises(osl.OmnistereoError, match=r"cam3 has no image of frame 2, other cameras have"):
        osl.load_dataset(tmp_path)


def test_fewer_folders_than_cameras(tmp_path):
    save(tmp_path, [1], cameras=3)
    with pytest.raises(osl.OmnistereoError, match=r"camera folders cam1, cam2, cam3, its rig has 4 cameras"):
        osl.load_dataset(tmp_path)


def test_a_folder_without_rig_frames_or_anything(tmp_path):
    with pytest.raises(osl.OmnistereoError, match="empty"):
        osl.load_dataset(tmp_path / "empty")
    with pytest.raises(osl.OmnistereoError, match=r"holds no frames: expected cam1.0001.png"):
        osl.load_dataset(save(tmp_path / "no_frames", []))


def test_a_frame_without_ground_truth_says_so(tmp_path):
    data = osl.load_dataset(save(tmp_path, [7], truth=None))
    assert data[0].gt_path is None
    with pytest.raises(osl.OmnistereoError, match="frame 7 has no ground truth"):
        data[0].inverse_depth


def test_the_widest_ground_truth_or_the_one_asked_for(tmp_path):
    save(tmp_path, [1], truth="omnidepth_gt_32")
    save(tmp_path, [1], truth="omnidepth_gt_640")
    assert osl.load_dataset(tmp_path)[0].gt_path.parent.name == "omnidepth_gt_640"
    assert osl.load_dataset(tmp_path, gt_width=32)[0].gt_path.parent.name == "omnidepth_gt_32"
    with pytest.raises(osl.OmnistereoError, match=r"ground truth of widths \[32, 640\], not of 320"):
        osl.load_dataset(tmp_path, gt_width=320)


def test_splits_in_folders(tmp_path):
    save(tmp_path / "train", [1, 2])
    save(tmp_path / "test", [3])
    assert [frame.number for frame in osl.load_dataset(tmp_path, "train")] == [1, 2]
    assert [frame.number for frame in osl.load_dataset(tmp_path, "test")] == [3]


def test_published_splits_by_number(tmp_path):
    sunny = save(tmp_path / "Sunny", [1, 700, 701, 1000, 1001], truth=None)
    assert [frame.number for frame in osl.load_dataset(sunny, "train")] == [1, 700]
    assert [frame.number for frame in osl.load_dataset(sunny, "test")] == [701, 1000]
    assert len(osl.load_dataset(sunny)) == 5
    with pytest.raises(osl.OmnistereoError, match=r"has no split 'validation'"):
        osl.load_dataset(sunny, "validation")
    with pytest.raises(osl.OmnistereoError, match=r"mine has no split 'test'.* sunny, cloudy"):
        osl.load_dataset(save(tmp_path / "mine", [1]), "test")
    with pytest.raises(osl.OmnistereoError, match="holds no frames of split test"):
        osl.load_dataset(save(tmp_path / "cloudy", [1]), "test")


def test_the_first_release_keeps_one_ground_truth_for_all_weathers(tmp_path):
    sunny = save(tmp_path / "sunny", [1, 701], truth=None)
    for split, number in (("train", 1), ("test", 701)):
        (tmp_path / f"depth_{split}_32").mkdir()
        write_inverse_depth(tmp_path / f"depth_{split}_32" / f"{number:04}.tiff", TRUTH)
    paths = [frame.gt_path for frame in osl.load_dataset(sunny)]
    assert [path.parent.name for path in paths] == ["depth_train_32", "depth_test_32"]


def test_a_set_in_another_light_points_to_the_ground_truth_of_its_drive(tmp_path):
    save(tmp_path / "sunny", [1], truth="omnidepth_gt_32")
    cloudy = save(tmp_path / "cloudy", [1], truth=None)
    with (cloudy / "config.yaml").open("a") as config:
        config.write("dataset: {truth: ../sunny}\n")
    assert np.array_equal(
        osl.load_dataset(cloudy)[0].inverse_depth, osl.load_dataset(tmp_path / "sunny")[0].inverse_depth
    )
    (tmp_path / "sunny").rename(tmp_path / "away")
    with pytest.raises(osl.OmnistereoError, match=r"ground truth is in \.\./sunny: there is no such folder"):
        osl.load_dataset(cloudy)


def test_float_tiff_comes_back(tmp_path):
    truth = TRUTH.copy()
    truth[0, :4] = [np.nan, np.inf, -1, 0]
    write_inverse_depth(tmp_path / "a.tiff", truth)
    read = read_inverse_depth(tmp_path / "a.tiff")
    assert np.isnan(read[0, :3]).all() and read[0, 3] == 0 and read.dtype == np.float32
    np.testing.assert_array_equal(read[1:], truth[1:])
    assert [path.name for path in tmp_path.iterdir()] == ["a.tiff"]


def test_the_float_page_behind_a_thumbnail(tmp_path):
    """The current releases: OpenCV and PIL show the thumbnail and lose the depth."""
    with tifffile.TiffWriter(tmp_path / "a.tiff") as tiff:
        tiff.write(np.zeros((4, 16, 3), np.uint8), photometric="rgb")
        tiff.write(TRUTH)
    np.testing.assert_array_equal(read_inverse_depth(tmp_path / "a.tiff"), TRUTH)


def test_png_counts_in_steps_of_the_nearest_depth(tmp_path):
    steps = np.array([[0, 655, 65500]], np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), steps)
    depth = 1 / read_inverse_depth(tmp_path / "a.png", min_depth=0.5)[0, 1:]
    np.testing.assert_allclose(depth, [50, 0.5], rtol=1e-6)
    assert read_inverse_depth(tmp_path / "a.png", min_depth=0.5)[0, 0] == 0
    with pytest.raises(osl.OmnistereoError, match="in units of 1/min_depth"):
        read_inverse_depth(tmp_path / "a.png")


def test_a_data_set_passes_the_rigs_nearest_depth_on(tmp_path):
    save(tmp_path, [1], rig=osl.Rig(RIG.cameras, RIG.T_rig_cam, min_depth=0.5), truth=None)
    (tmp_path / "depth_test_2").mkdir()
    cv2.imwrite(str(tmp_path / "depth_test_2" / "00001.png"), np.full((1, 2), 65500, np.uint16))
    assert osl.load_dataset(tmp_path)[0].inverse_depth.tolist() == [[2, 2]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.tiff", None, "cannot be read: No such file"),
        ("a.tiff", b"", "is not a whole TIFF file"),
        ("a.tiff", b"hello", "is not a whole TIFF file"),
        ("a.png", b"", "holds no picture, 0 bytes"),
        ("a.png", b"hello", "holds no picture, 5 bytes"),
    ],
)
def test_ground_truth_that_is_none(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(osl.OmnistereoError, match=f"{name} {message}"):
        read_inverse_depth(tmp_path / name, 0.5)


def test_ground_truth_of_another_kind(tmp_path):
    write_image(tmp_path / "a.png", np.zeros((4, 8), np.uint8))
    with pytest.raises(osl.OmnistereoError, match=r"uint8 of shape \(4, 8\), expected 16-bit gray"):
        read_inverse_depth(tmp_path / "a.png", 0.5)
    tifffile.imwrite(tmp_path / "a.tiff", np.zeros((4, 8, 3), np.uint8), photometric="rgb")
    with pytest.raises(osl.OmnistereoError, match="has 0 float pages, expected one"):
        read_inverse_depth(tmp_path / "a.tiff")


def test_a_tiff_cut_anywhere_is_refused(tmp_path):
    write_inverse_depth(tmp_path / "whole.tiff", TRUTH)
    content = (tmp_path / "whole.tiff").read_bytes()
    for keep in range(0, len(content), 37):
        (tmp_path / "a.tiff").write_bytes(content[:keep])
        try:
            np.testing.assert_array_equal(read_inverse_depth(tmp_path / "a.tiff"), TRUTH)
        except osl.OmnistereoError:
            continue


def frame_with(tmp_path, truth):
    write_inverse_depth(tmp_path / "truth.tiff", truth)
    return Frame(1, [], tmp_path / "truth.tiff")


def truth_of(grid):
    """The inverse depth of the closed-form world on a grid."""
    return 1 / scene.distance(np.zeros(3), grid.rays())


@pytest.mark.parametrize("sampling", ["center", "sweepnet", "omnimvs"])
def test_gt_index_on_the_ground_truths_own_grid_is_exact(tmp_path, sampling):
    grid = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7, sampling=sampling)
    truth = truth_of(grid).astype(np.float32)
    index = frame_with(tmp_path, truth).gt_index(grid)
    np.testing.assert_allclose(index, truth.astype(np.float64) * 0.7 * 47, rtol=1e-15)


def test_gt_index_takes_the_nearest_ray_of_another_size(tmp_path):
    fine = osl.SphereGrid(192, 48, (-45, 45), 48, 0.7)
    coarse = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7)  # its pixel centres are the fine grid's every third
    index = frame_with(tmp_path, truth_of(fine)).gt_index(coarse)
    np.testing.assert_allclose(index, coarse.inverse_depth_to_index(truth_of(coarse)), rtol=1e-6)


def test_gt_index_of_a_full_sphere_on_a_band_and_back(tmp_path):
    """640 × 320 reaches from pole to pole: a band of ±45° takes its middle half, it does not squeeze it."""
    whole = osl.SphereGrid(64, 32, (-90, 90), 48, 0.7)
    band = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7)
    index = frame_with(tmp_path, truth_of(whole)).gt_index(band)
    np.testing.assert_allclose(index, band.inverse_depth_to_index(truth_of(band)), rtol=1e-6)
    index = frame_with(tmp_path, truth_of(band)).gt_index(whole)
    assert np.isnan(index[:8]).all() and np.isnan(index[24:]).all() and np.isfinite(index[8:24]).all()
    np.testing.assert_allclose(index[8:24], whole.inverse_depth_to_index(truth_of(band)), rtol=1e-6)


def test_gt_index_keeps_the_unknown_unknown(tmp_path):
    grid = osl.SphereGrid(64, 16, (-45, 45), 48, 0.7)
    truth = truth_of(grid)
    truth[3, 5] = np.nan
    index = frame_with(tmp_path, truth).gt_index(grid)
    assert np.isnan(index[3, 5]) and np.isnan(index).sum() == 1


def test_a_frame_by_its_number(tmp_path):
    data = osl.load_dataset(save(tmp_path, [3, 17]))
    assert data.frame(17).number == 17
    with pytest.raises(osl.OmnistereoError, match="has no frame 5, it has 3, 17"):
        data.frame(5)
