"""The frames that ship: streets in three lights, from the air, a room."""

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest
from lens_oracle import directions

import omnistereo_lib as osl
from omnistereo_lib.geometry.trajectory import read_trajectory
from workshop.render.camera.render_rig import make_rig, write_config
from workshop.render.city.drive import plan_drive
from workshop.render.city.layout import plan_district
from workshop.render.image_sets import SEED, SETS

SAMPLES = Path(osl.__file__).parents[1] / "data_samples" / "sunny"
DISTRICT = plan_district(SEED)

GRID = osl.SphereGrid(640, 160, num_spheres=192, min_depth=1.65)
OTHERS = {
    "aerial/test": osl.SphereGrid(640, 320, (-90, 90), num_spheres=192, min_depth=1.65),
    "indoor/test": osl.SphereGrid(640, 160, num_spheres=192, min_depth=0.55),
}
WINDOW = 5  # 2.8°, as 9 at the width of the paper


@pytest.fixture(scope="module")
def shipped():
    return osl.load_dataset(SAMPLES, split="test")


def test_shipped_rig_is_the_one_of_the_seed(shipped, tmp_path):
    write_config(tmp_path / "config.yaml", make_rig(SEED), SETS["sunny/test"].size, {"start": 701})
    made = osl.load_rig(tmp_path)
    rays = directions(110)
    for old, new in zip(shipped.rig.cameras, made.cameras, strict=True):
        np.testing.assert_allclose(old.project(rays)[0], new.project(rays)[0], atol=1e-6)
    for old, new in zip(shipped.rig.T_rig_cam, made.T_rig_cam, strict=True):
        np.testing.assert_allclose(old.as_vector(), new.as_vector(), atol=1e-12)


def sample(panorama, pixels, how):
    """Look a panorama up at (column, row), around the seam."""
    maps = (pixels + np.array([8, 0])).astype(np.float32)
    return cv2.remap(
        np.pad(panorama, ((0, 0), (8, 8)), mode="wrap"), maps[..., 0], maps[..., 1], how
    )


def around(panorama, size):
    """The lowest and the highest value in the window around each pixel, around the seam."""
    wide = np.pad(panorama, ((0, 0), (size, size)), mode="wrap")
    window = np.ones((size, size), np.uint8)
    return tuple(find(wide, window)[:, size:-size] for find in (cv2.erode, cv2.dilate))


def all_around(mask, size=WINDOW):
    """Where a mask is true in the whole window around a pixel."""
    return around(mask.astype(np.uint8), size)[0] > 0


def means(picture, size=WINDOW):
    """The mean over the window around each pixel, around the seam."""
    return cv2.blur(np.pad(picture, ((0, 0), (size, size)), mode="wrap"), (size, size))[
        :, size:-size
    ]


def test_truths_of_both_sizes_agree_where_depth_is_smooth(shipped):
    fine = shipped[-1].inverse_depth
    coarse = osl.load_dataset(SAMPLES, split="test", gt_width=640)[-1].inverse_depth
    pixels, _ = osl.SphereGrid(1200, 300).project(GRID.rays())
    low, high = (sample(values, pixels, cv2.INTER_NEAREST) for values in around(fine, 3))
    smooth = (low > 0) & (high < 1.05 * low)
    smooth[[0, -1]] = False
    assert smooth.mean() > 0.5
    coarse = coarse[smooth]
    difference = np.abs(sample(fine, pixels, cv2.INTER_LINEAR)[smooth] / coarse - 1)
    assert np.median(difference) < 5e-5 and np.quantile(difference, 0.9) < 2e-3
    # A pixel of the finer one beside it, and it is seen:
    beside = np.abs(sample(fine, pixels + np.array([0, 1]), cv2.INTER_LINEAR)[smooth] / coarse - 1)
    assert np.median(beside) > 1e-3


def surely_seen(center, inverse_depth, grid):
    """Where a camera surely sees the point of a ray: the line of sight is free."""
    with np.errstate(divide="ignore"):
        points = grid.rays() * np.minimum(1 / inverse_depth, 1e4)[..., None]
    seen = np.ones(grid.shape, bool)
    for share_of_way in np.linspace(0.05, 0.995, 8):
        between = center + share_of_way * (points - center)
        pixels, inside = grid.project(between)
        there = sample(inverse_depth, pixels, cv2.INTER_NEAREST)
        covered = np.linalg.norm(between, axis=-1) * there > 1.02
        seen &= inside & ~covered
    return seen


def warped_zncc(frame, inverse_depth, grid):
    """ZNCC and contrast of neighbouring cameras' images, warped with a depth for each ray."""
    sweep = osl.SphereSweep(frame.rig, grid)
    gray = [x if x.ndim == 2 else cv2.cvtColor(x, cv2.COLOR_RGB2GRAY) for x in frame.images]
    warped = sweep.warp(
        [image.astype(np.float32) for image in gray], grid.inverse_depth_to_index(inverse_depth)
    )
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        both = np.isfinite(warped[a]) & np.isfinite(warped[b])
        A, B = (np.where(both, image, 0) for image in (warped[a], warped[b]))
        spread = [means(image * image) - means(image) ** 2 for image in (A, B)]
        covariance = means(A * B) - means(A) * means(B)
        with np.errstate(invalid="ignore", divide="ignore"):
            zncc = covariance / np.sqrt(spread[0] * spread[1])
        yield (a, b), np.where(all_around(both), zncc, np.nan), np.sqrt(np.minimum(*spread).clip(0))


# Set, frame, how much depth may differ in a window (with shelves close by, two depths do not fit
# one warp), and the share of a wrong depth's good windows in those of the truth.
WARPED = [
    ("sunny/test", -1, 1.15, 0.7),
    ("sunset/test", 4, 1.1, 0.7),
    ("sunny/train", 60, 1.1, 0.7),
    ("aerial/test", 0, 1.02, 0.5),
    ("indoor/test", 0, 1.02, 0.5),
]


@pytest.mark.parametrize(("name", "i", "even", "share"), WARPED)
def test_images_warped_with_the_truth_agree(name, i, even, share):
    """Noise reaches 7 gray values in shadows: texture is what has three times that contrast."""
    data = osl.load_dataset(SAMPLES.parent / name, gt_width=640)
    grid, truth = OTHERS.get(name, GRID), data[i].inverse_depth
    low, high = around(truth, WINDOW)
    smooth = (low > 0) & (high < even * low)
    seen = [surely_seen(center, truth, grid) for center in data.rig.centers]
    wrong = warped_zncc(data[i], truth * 1.2, grid)
    good = []
    for ((a, b), zncc, contrast), (_, off, _) in zip(
        warped_zncc(data[i], truth, grid), wrong, strict=True
    ):
        textured = smooth & all_around(seen[a] & seen[b]) & np.isfinite(zncc) & (contrast > 20)
        assert textured.sum() > 300 and np.median(zncc[textured]) > 0.95
        good.append(((zncc[textured] > 0.9).mean(), (off[textured] > 0.9).mean()))
    right, off = np.mean(good, 0)
    assert right > 0.9 and off < share * right


# The sets beside the street's: from the air, and in a room


def test_aerial_truth_is_the_full_sphere_of_a_tilted_rig_above_a_street():
    data, images = osl.load_dataset(SAMPLES.parent / "aerial", split="test"), SETS["aerial/test"]
    drive = plan_drive(DISTRICT, images.route, images.count)
    for frame in data:
        T_world_rig = drive.pose(frame.number - images.first) @ osl.Pose.from_vector(
            images.T_drive_rig
        )
        tilt = np.degrees(np.arccos(-T_world_rig.R[2, 1]))  # between the rig's down and the world's
        assert 12 < tilt < 18 and 15 < T_world_rig.t[2] < 20
        grid = osl.SphereGrid(1200, 600, (-90, 90))
        truth = frame.inverse_depth
        assert truth.shape == grid.shape
        assert np.isfinite(frame.gt_index(OTHERS["aerial/test"])).all()
        rays = grid.rays() @ T_world_rig.R.T
        assert (truth[rays[..., 2] < -0.05] > 0).all() and (truth[rays[..., 2] > 0.99] == 0).all()
        height = (T_world_rig.t + rays[truth > 0] / truth[truth > 0, None])[:, 2]
        below = -rays[truth > 0, 2] > 0.9
        # the file's steps: 4 cm at 100 m
        assert np.abs(height[below]).min() < 1e-3 and height.min() > -0.1
        # carriageway and pavement; the rest stands on them
        assert (np.abs(height[below]) < 0.2).mean() > 0.4


# The street in other lights, and the streets that training sees


def test_other_lights_show_the_same_street():
    lights = (SAMPLES.parent / name / "test" for name in ("sunny", "cloudy", "sunset"))
    sunny, cloudy, sunset = (osl.load_dataset(folder, gt_width=640) for folder in lights)
    for data in (cloudy, sunset):
        assert [frame.gt_path.resolve() for frame in data] == [
            frame.gt_path.resolve() for frame in sunny
        ]
        for old, new in zip(sunny.rig.T_rig_cam, data.rig.T_rig_cam, strict=True):
            np.testing.assert_array_equal(old.as_vector(), new.as_vector())
    # Blue under the sun, gray under clouds, in between with the evening's red in it.
    assert sky_warmth(sunny[0]) < 0.9 * sky_warmth(sunset[0]) < 0.9 * sky_warmth(cloudy[0])


def sky_warmth(frame):
    """Red by blue of the sky, the mean over a frame."""
    sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(640, 160, num_spheres=2, min_depth=1.65))
    channels = ([image[..., k].astype(np.float32) for image in frame.images] for k in (0, 2))
    red, blue = (np.nanmean(sweep.warp(images, 0), axis=0) for images in channels)
    return (red / (blue + 1))[frame.inverse_depth == 0].mean()


def test_the_sample_is_a_frame_of_the_test_drive_with_images_twice_as_wide(shipped):
    """Made smaller, its images are the drive's but for noise; a row off, they are not."""
    (sample,) = osl.load_dataset(SAMPLES.parents[1] / "omnistereo_lib" / "sample")
    frame = osl.load_dataset(SAMPLES, split="test", gt_width=640).frame(831)
    assert sample.number == 831 and SETS["sample"].shipped == (831,)
    np.testing.assert_allclose(sample.inverse_depth, frame.inverse_depth, rtol=1e-4)
    rays = directions(100)
    for k, (wide, image) in enumerate(zip(sample.images, frame.images, strict=True)):
        assert wide.shape == (1536, 1600, 3)
        fine, coarse = (rig.cameras[k].project(rays)[0] for rig in (sample.rig, frame.rig))
        np.testing.assert_allclose((fine + 0.5) / 2 - 0.5, coarse, atol=0.02)
        small = cv2.resize(wide, (800, 768), interpolation=cv2.INTER_AREA)
        off, beside = (cv2.absdiff(np.roll(small, by, 0), image).mean() for by in (0, 1))
        assert off < 0.7 * beside


def test_the_drive_s_frames_follow_one_another_on_its_trajectory():
    """What one frame sees lies where the next one sees it, by the trajectory, unless it drives."""
    data = osl.load_dataset(SAMPLES.parent / "drive", split="test")
    poses = read_trajectory(SAMPLES.parent / "drive/test/trajectory.txt")
    assert tuple(frame.number for frame in data) == SETS["drive/test"].shipped == tuple(poses)
    for a, b in itertools.pairwise(data):
        T_b_a = poses[b.number].inverse() @ poses[a.number]
        assert 1 < np.linalg.norm(T_b_a.t) < 2
        near = a.inverse_depth > 1 / 25
        points = T_b_a @ (GRID.rays()[near] / a.inverse_depth[near, None])
        pixels, inside = GRID.project(points)
        column, row = np.rint(pixels[inside]).astype(int).T
        seen = b.inverse_depth[row.clip(0, 159), column % 640] * np.linalg.norm(
            points[inside], axis=-1
        )
        # without the poses, or turned round, at most 0.75
        assert (np.abs(seen - 1) < 0.05).mean() > 0.85
