"""What `omnistereo depth` leaves behind, against a box whose walls are known."""

import re
import warnings
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import scene
import tifffile
from PIL import Image, ImageFont
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.pictures import read_pixels, write_image
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.input.masks import with_masks
from omnistereo_tools.output import overview
from omnistereo_tools.output.colors import ColorScale
from omnistereo_tools.output.frame import FrameResult
from omnistereo_tools.output.points import Limits, PointCloud
from omnistereo_tools.output.summary import depth_sentences, error_sentences, nearest_depth, verdict

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)


NOTHING = np.zeros(GRID.shape, bool)


@pytest.fixture(scope="module")
def rig():
    return scene.rig(width=200, height=192)


@pytest.fixture(scope="module")
def depth(rig, pictures):
    """The true depth of the box, with a confidence that grows from left to right."""
    index = scene.true_index(rig, GRID).astype(np.float32)
    index[0, 0] = np.nan
    confidence = np.broadcast_to(np.linspace(0, 1, 160, dtype=np.float32), GRID.shape).copy()
    return osl.Depth(
        index, np.where(np.isnan(index), np.nan, confidence), SphereSweep(rig, GRID), pictures
    )


@pytest.fixture(scope="module")
def pictures(rig):
    return [
        np.stack([picture.astype(np.uint8)] * 3, -1) for picture in scene.images(rig, finest=0.25)
    ]


@pytest.fixture(scope="module")
def written(depth, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    FrameResult(depth, Limits.of(depth), "zncc+sgm", depth.index).write(out)
    return out


def test_the_points_are_on_the_walls_and_the_normals_across_them(written, depth):
    trimesh = pytest.importorskip("trimesh")
    cloud = trimesh.load(written / "data" / "points.ply").metadata["_ply_raw"]["vertex"]["data"]
    points, normals = (
        np.stack([cloud[name] for name in names], -1)
        for names in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    center = np.mean([pose.t for pose in scene.rig(width=200, height=192).T_rig_cam], 0)
    beyond = np.abs(points + center - scene.CENTER) / scene.HALF_SIZE
    np.testing.assert_allclose(beyond.max(-1), 1, atol=1e-4)
    inside = np.sort(beyond, -1)[:, -2] < 0.85  # not at an edge of the box
    wall = beyond.argmax(-1)[inside]
    towards = -np.sign(points[inside, wall])
    facing = normals[inside][np.arange(len(wall)), wall] * towards
    assert np.median(facing) > 0.999
    assert (facing > 0.98).mean() > 0.99
    assert len(points) == depth.valid.sum() and cloud["quality"].min() == 0  # nothing is lost,
    # but marked
    assert 0 < cloud["doubtful"].mean() < 0.7 and cloud["doubtful"][cloud["quality"] == 0].all()


def test_limits_drop_what_is_far_or_unsure(depth):
    cloud = PointCloud.of(
        depth, np.zeros(GRID.shape, np.float32), Limits(2.0, 0.5), depth.confidence < 0.7
    )
    assert np.linalg.norm(cloud.points, axis=-1).max() <= 2.0 and cloud.confidence.min() >= 0.5
    assert (
        len(cloud.points)
        == (depth.valid & (depth.depth <= 2) & (depth.confidence >= 0.5)).sum()
        > 0
    )
    np.testing.assert_array_equal(cloud.doubtful, cloud.confidence < 0.7)


def test_the_sentences_say_what_was_found(depth):
    truth = depth.depth[depth.valid]
    _, first, second, *hints = depth_sentences(depth, Limits(1e9, 0.0), NOTHING)
    assert re.search(
        rf"the nearest sure thing is {nearest_depth(depth, depth.valid):.2g} m away, the median",
        first,
    )
    assert f"uses {depth.valid.sum()} rays. Left out: 0 beyond" in second
    nearest = truth.min()
    assert (0.8 * nearest > 1.2 * GRID.min_depth) == bool(hints)
    exact, _ = error_sentences(depth, scene.true_index(scene.rig(width=200, height=192), GRID))
    assert (
        "half of the rays are within 0.0 % of their true depth and nine tenths within 0 %" in exact
    )
    off = osl.Depth(depth.index * 1.1, depth.confidence, depth.sweep)
    # 1 - 1 / 1.1
    assert "half of the rays are within 9.1 % of" in error_sentences(off, depth.index)[0]
    index = np.where(np.arange(160) < 9, 0, depth.index)  # the sky is infinitely far in both
    with warnings.catch_warnings(action="error"):
        assert (
            "within 0.0 % of"
            in error_sentences(osl.Depth(index, depth.confidence, depth.sweep), index)[0]
        )


def test_what_is_doubtful_is_told_and_not_the_nearest_thing(depth):
    nearest, sure = nearest_depth(depth, depth.valid), np.nanquantile(depth.depth, 0.3)
    verdict, first, second, third, *_ = depth_sentences(
        depth, Limits(1e9, 0.0), depth.depth <= sure
    )
    assert verdict == "Fair: 31 % of rays are doubtful."
    assert f"the nearest sure thing is {sure:.2g} m away" in first
    assert second.startswith("Of the nearest tenth of rays, up to ")
    assert "100 % are doubtful" in second
    assert second.endswith(f"If they are right, the nearest thing is {nearest:.2g} m away.")
    assert f"uses {depth.valid.sum()} rays" in third


def test_the_nearest_thing_covers_2_permille_of_the_sphere(depth):
    """Not of the rays: on the sample frame a few rays at the nadir were 1.7 m for a road at 1.9."""
    truth = np.sort(depth.depth[depth.valid])
    below, above = truth[[int(share * truth.size) for share in (0.0015, 0.0025)]]
    assert below <= nearest_depth(depth, depth.valid) <= above  # within 45° it is nearly the same
    grid = replace(GRID, phi_deg=(-90.0, 90.0))
    index = np.full(grid.shape, 5.0)
    index[-1] = 12  # 2 % of the rays, but .04 % of the sphere
    found = osl.Depth(index, np.ones(grid.shape), osl.SphereSweep(depth.sweep.rig, grid))
    assert nearest_depth(found, found.valid) == pytest.approx(grid.index_to_depth(5))


def test_the_rig_is_suspected_of_doubtful_rays_but_so_is_a_coarse_grid(depth):
    """With 160 columns a right rig gets more than half of them, too; 320 are enough."""
    doubtful = depth.depth <= np.nanquantile(depth.depth, 0.6)
    said = depth_sentences(depth, Limits(1e9, 0.0), doubtful)[0]
    assert said.startswith("Bad: 6")
    assert said.endswith(": 160 columns are too few, or the rig and the images may not fit.")
    assert (
        verdict(60.0, 320) == "Bad: 60 % of rays are doubtful: the rig and the images may not fit."
    )
    assert verdict(7.0, 320) == "Good: 93 % of rays are sure."


def test_a_depth_that_is_the_same_all_around_is_not_good(depth):
    """As of a method of one's own that measures nothing, sure of it as it may be."""
    sure, noise = np.ones(GRID.shape), np.random.default_rng(0).uniform(-0.2, 0.2, GRID.shape)
    for index in (np.full(GRID.shape, 20.0), 20 + noise):
        found = osl.Depth(index, sure, depth.sweep)
        verdict = depth_sentences(found, Limits(1e9, 0.0), NOTHING)[0]
        away = f"{GRID.index_to_depth(20):.2g} m"
        assert verdict == f"Bad: 100 % of rays are at one distance, {away}: nothing is told apart."
    off = osl.Depth(depth.index, sure, depth.sweep)
    assert depth_sentences(off, Limits(1e9, 0.0), NOTHING)[0].startswith("Good")


def test_a_frame_without_a_point_is_written_too(depth, tmp_path):
    result = FrameResult(depth, Limits(0.1, 0.0), "zncc+sgm")
    result.write(tmp_path)
    _, first, *_, second = result.sentences
    assert "unknown away" not in first and "no ray is within" in first
    assert f"uses 0 rays. Left out: {depth.valid.sum()} beyond 0.1 m" in second
    assert b"element vertex 0" in (tmp_path / "data" / "points.ply").read_bytes()


def test_nearer_spheres_are_proposed_where_nothing_is_near(rig):
    grid = replace(GRID, min_depth=0.3)
    index = scene.true_index(rig, grid).astype(np.float32)
    far = osl.Depth(index, np.ones_like(index), SphereSweep(rig, grid))
    nearest = np.quantile(far.depth, 0.002)
    assert (
        f"--min-depth {0.8 * nearest:.2g} would use them better"
        in depth_sentences(far, Limits(1e9, 0.0), NOTHING)[-1]
    )


def test_the_colours_span_the_depths_found():
    scale = ColorScale.of(np.array([[0.5, 1.0, 2.0, np.nan]]))
    assert 0.5 <= scale.low < 0.52 and 1.97 < scale.high <= 2.0
    labels = {label: at for at, label in scale.ticks()}
    assert labels["1 m"] == pytest.approx((1 - scale.low) / (scale.high - scale.low))
    assert "∞" not in labels
    brightness = scale.bar(256)[0].sum(-1)
    assert (np.diff(brightness.astype(int)) >= -3).all() and brightness[-1] > 600


@pytest.mark.parametrize("nearest", [0.07, 0.6, 1.65, 12])
def test_no_letters_of_the_overview_touch(monkeypatch, pictures, rig, nearest):
    boxes = []

    def write(page, place, text, anchor, size=overview._TEXT):
        font = ImageFont.truetype(overview.FONT, size)
        boxes.append((text, page._draw.textbbox(place, text, font, anchor)))
        return int(boxes[-1][1][3])

    monkeypatch.setattr(overview._Page, "write", write)
    grid = osl.SphereGrid(160, 80, (-90, 90), num_spheres=64, min_depth=nearest)
    index = np.broadcast_to(np.linspace(0, 63, 160, dtype=np.float32), grid.shape)
    found = osl.Depth(index, np.ones_like(index), SphereSweep(rig, grid), pictures)
    panorama = np.zeros((80, 160, 3), np.uint8)
    overview.draw_overview(found, panorama, np.ones_like(index), "title", "Good", [("A", "b")])
    assert len(boxes) > 20
    for (a, (left, top, right, bottom)), (b, other) in combinations(boxes, 2):
        apart = right + 4 <= other[0] or other[2] + 4 <= left
        assert apart or bottom <= other[1] or other[3] <= top, (a, b)


def test_masks_beside_the_images(rig, tmp_path):
    mask = np.zeros((192, 200), np.uint8)
    mask[:100] = 255
    images = [tmp_path / f"cam{k}" / "1.png" for k in range(4)]
    for k, path in enumerate(images):
        path.parent.mkdir()
        if k != 2:
            write_image(path.parent / "mask.png", mask)
    found = [camera.mask for camera in with_masks(rig, images).cameras]
    assert found[2] is None and (found[0] == (mask > 0)).all()
    # one folder: whose mask would it be?
    together = [tmp_path / "cam0" / f"{k}.png" for k in range(4)]
    assert with_masks(rig, together) is rig
    write_image(images[0].parent / "mask.png", mask[:50])
    with refused(r"mask.png is 200 × 50 px; the camera has 200 × 192 px"):
        with_masks(rig, images)


def test_files_for_other_programs(written, depth):
    """Nodata where nothing is known, whole millimetres, the part of the sphere that is shown."""
    data = written / "data"
    with Image.open(data / "panorama.jpg") as picture:
        tags = picture.getxmp()["xmpmeta"]["RDF"]["Description"]
    rows = [int(tags[f"{name}Pixels"]) for name in ("FullPanoHeight", "CroppedAreaTop")]
    assert rows == [80, round((depth.grid.phi_deg[0] + 90) / 180 * 80)]
    for name in ("inverse_depth", "confidence", "trust"):
        with tifffile.TiffFile(data / f"{name}.tiff") as file:
            assert file.pages[0].tags[42113].value == "nan"
    found = read_pixels(data / "depth_mm.png")
    known = depth.valid & (depth.depth < 65)
    np.testing.assert_allclose(found[known], 1000 * depth.depth[known], atol=0.51)
    assert found.dtype == np.uint16 and not found[~depth.valid].any()
