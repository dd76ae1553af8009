"""The viewer in a real browser, without any network: what it says is the depth."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.output.points import Limits
from omnistereo_tools.output.viewer import page_of, viewer_data, viewer_page

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)


@pytest.fixture
def depth():
    rig = scene.rig(width=200, height=192)
    index = scene.true_index(rig, GRID).astype(np.float32)
    return osl.Depth(index, np.full_like(index, 0.75), SphereSweep(rig, GRID))


def test_it_looks_around_and_tells_the_depth(depth, open_page, tmp_path):
    panorama = np.full((80, 320, 3), (200, 60, 40), np.uint8)
    (tmp_path / "index.html").write_text(viewer_page(depth, panorama, Limits(50.0, 0.0), "a <box>"), encoding="utf-8")
    page = open_page(1200, 900)
    page.goto(f"file://{tmp_path}/index.html")
    page.wait_for_selector("body[data-drawn=look]")
    assert page.inner_text("#title") == "a <box>"
    middle = page.evaluate("[...document.getElementById('view').getContext('2d').getImageData(560, 315, 1, 1).data]")
    np.testing.assert_allclose(middle, [200, 60, 40, 255], atol=4)  # JPEG
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2 + 2, box["y"] + box["height"] / 2 + 2)
    told = re.fullmatch(r"(\d+\.\d+) m, confidence 0.75", page.inner_text("#readout"))
    assert float(told[1]) == pytest.approx(depth.depth[20, 80], abs=0.01)
    page.check("input[value=points]")
    page.wait_for_selector("body[data-drawn=points]")
    shown = page.evaluate("owner.reduce((count, k) => count + (k >= 0), 0)")
    assert shown > 10_000 and page.complaints == []


def opened(open_page, folder, page_text, **options):
    (folder / "index.html").write_text(page_text, encoding="utf-8")
    page = open_page(1200, 900, **options)
    page.goto(f"file://{folder}/index.html")
    page.wait_for_selector("body[data-drawn]")
    return page


def point_of(depth, row, column):
    return depth.depth[row, column] * depth.grid.rays()[row, column]


@pytest.mark.parametrize("touch", [False, True], ids=["mouse", "touch"])
@pytest.mark.parametrize("mode", ["look", "flat"])
def test_two_picks_give_the_distance_between_their_points(depth, open_page, tmp_path, mode, touch):
    data = viewer_data(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "picks", mode)
    page = opened(open_page, tmp_path, page_of(data), has_touch=touch)
    box = page.locator("#view").bounding_box()
    press = page.touchscreen.tap if touch else page.mouse.click
    cells = (22, 74), (25, 88)
    for number, cell in enumerate(cells):
        ray = (point_of(depth, *cell) / depth.depth[cell]).tolist()
        x, y = page.evaluate("ray => placeOf(ray)", ray)
        press(box["x"] + x / 1120 * box["width"], box["y"] + y / 630 * box["height"])
        told = page.inner_text("#readout")  # a finger does not hover
        assert float(told.partition(" m")[0]) == pytest.approx(depth.depth[cell], abs=0.06)
        assert page.inner_text("#distance").endswith("Pick another one" if number == 0 else "between the two marks")
    distance = np.linalg.norm(point_of(depth, *cells[0]) - point_of(depth, *cells[1]))
    assert float(page.inner_text("#distance").split()[0]) == pytest.approx(distance, abs=0.06)
    page.mouse.move(box["x"] + 300, box["y"] + 300)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 300)
    page.mouse.up()  # a drag picks nothing
    assert page.inner_text("#distance").endswith("between the two marks") and page.complaints == []


def test_it_shows_the_exact_depth_and_the_error(depth, open_page, tmp_path):
    truth = depth.index + np.where(np.arange(160) < 80, 0.0, 3.2)  # 5 % of the spheres, on the right
    page_text = viewer_page(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "errors", gt_index=truth)
    page = opened(open_page, tmp_path, page_text)
    page.select_option("#layer", "error")
    colors = page.evaluate("[...colors]")
    for column, at in ((60, 0), (120, 128)):  # of 256 colours up to 10 %
        k = 40 * 320 + 2 * column
        found = page.evaluate(f"[...painted.slice(3 * {k}, 3 * {k} + 3)]")
        np.testing.assert_allclose(found, colors[3 * at : 3 * at + 3], atol=4)
    assert page.inner_text("#scale").startswith("0 %")
    plain = opened(open_page, tmp_path, viewer_page(depth, np.zeros((8, 32, 3), np.uint8), Limits(50.0, 0.0), "none"))
    assert not plain.locator("#layer").is_visible()


def test_depth_has_no_stairs_but_edges(depth, open_page, tmp_path):
    index = np.tile(np.linspace(10, 12, 160, dtype=np.float32), (40, 1))  # a slope
    index[:, 100:] += 40  # and an edge
    slope = osl.Depth(index, depth.confidence, depth.sweep)
    page = opened(
        open_page, tmp_path, viewer_page(slope, np.zeros((160, 640, 3), np.uint8), Limits(50.0, 0.0), "slope")
    )
    x = np.arange(100, 540)
    values = page.evaluate(
        "xs => { const v = Float32Array.from(steps, (_, k) => onScale(k)); return xs.map(x => between(x / 4, 20, v)) }",
        x.tolist(),
    )
    jumps = np.abs(np.diff(values))
    assert (jumps > 0.1).sum() == 1  # the edge stays sharp
    rest = np.delete(jumps, jumps.argmax())
    assert rest.max() < 1.5 * np.median(rest)


def test_a_surface_of_points_has_no_gaps(depth, open_page, tmp_path):
    down = depth.grid.rays()[..., 1]
    floor = depth.grid.depth_to_index(np.where(down > 0.3, 1.5 / np.maximum(down, 0.3), np.inf))  # 1.5 m below
    data = viewer_data(
        osl.Depth(floor.astype(np.float32), depth.confidence, depth.sweep),
        np.full((80, 320, 3), 200, np.uint8),
        Limits(50.0, 0.0),
        "floor",
        "points",
    )
    page = opened(open_page, tmp_path, page_of(data))
    covered = page.evaluate("""() => points.cells.filter(k => k + D.width < steps.length).map(k => {
        const [a, b] = [pointOf(k), pointOf(k + D.width)]
        const [x, y] = placeOf(a.map((value, i) => (value + b[i]) / 2)).map(Math.floor)
        return x < 0 || y < 0 || x >= W || y >= H || owner[y * W + x] >= 0
    })""")
    assert len(covered) > 1000 and np.mean(covered) > 0.97


@pytest.mark.parametrize("touch", [False, True], ids=["mouse", "touch"])
def test_it_shows_where_the_cameras_see_a_ray(depth, open_page, tmp_path, touch):
    rig = depth.sweep.rig
    mask = np.ones((192, 200), bool)
    mask[:, :100] = False
    rig = replace(rig, cameras=(replace(rig.cameras[0], mask=mask), *rig.cameras[1:]))
    images = [np.full((192, 200), 90, np.uint8)] * 4
    depth = replace(depth, sweep=SphereSweep(rig, GRID), images=images)
    truth = depth.index + 5.0
    panorama = np.zeros((80, 320, 3), np.uint8)
    data = viewer_data(depth, panorama, Limits(50.0, 0.0), "rays", gt_index=truth)
    page = opened(open_page, tmp_path, page_of(data), has_touch=touch)
    for index, layer in ((depth.index, "steps"), (truth, "truth")):
        found = page.evaluate(f"D.cameras.map(c => [...steps.keys()].map(k => pixelOf(c, k, {layer})))")
        for camera, at in enumerate(found):
            pixels, valid = depth.sweep.project_sphere(camera, index)
            seen = np.array([pixel is not None for pixel in at])
            assert (seen != valid.ravel()).mean() < 0.01  # along the rim
            both = seen & valid.ravel()
            assert both.sum() > 500
            shown = np.array([pixel for pixel, keep in zip(at, both, strict=True) if keep])
            np.testing.assert_allclose(shown, pixels.reshape(-1, 2)[both], atol=0.15)  # the depth is rounded
    box = page.locator("#view").bounding_box()
    press = page.touchscreen.tap if touch else page.mouse.click
    row, column = 22, 74
    x, y = page.evaluate("ray => placeOf(ray)", point_of(depth, row, column).tolist())
    press(box["x"] + x / 1120 * box["width"], box["y"] + y / 630 * box["height"])
    captions = page.locator("#fisheyes figcaption").all_inner_texts()
    for camera, caption in enumerate(captions):
        pixels, valid = depth.sweep.project_sphere(camera, depth.index)
        place = "sees it at {:.0f}, {:.0f}".format(*pixels[row, column]) if valid[row, column] else "does not see it"
        assert caption == f"camera {camera + 1} {place}"
        u, v = (pixels[row, column] + 0.5) * 240 / 200
        yellow = page.evaluate(
            "([i, u, v]) => [...fisheyes[i].canvas.getContext('2d').getImageData(u, v, 1, 1).data]",
            [camera, round(u + 10), round(v - 0.5)],
        )
        assert (yellow[:3] == [255, 255, 0]) == valid[row, column]
    assert {caption.endswith("does not see it") for caption in captions} == {True, False} and page.complaints == []


def test_surfaces_have_the_picture_on_them_and_no_gaps(depth, open_page, tmp_path):
    rows, columns = np.indices((80, 320))
    panorama = np.stack([columns * 255 // 320, rows * 255 // 80, np.full_like(rows, 128)], -1).astype(np.uint8)
    data = viewer_data(depth, panorama, Limits(50.0, 0.0), "surfaces")
    page = opened(open_page, tmp_path, page_of(data))
    page.check("input[value=surfaces]")
    page.wait_for_selector("body[data-drawn=surfaces]")
    for distance in (1e-3, 0.2):  # from the rig, where nothing is hidden, and from behind it
        page.evaluate(f"Object.assign(view, {{ turn: 3, tilt: 0, distance: {distance} }}); drawSurfaces()")
        found = page.evaluate("""() => points.cells.map((k, i) => {
            const [x, y] = placeOf(pointOf(k))?.map(Math.floor) ?? [-1, -1], place = y * W + x
            return x < 0 || y < 0 || x >= W || y >= H ? [] : [k, owner[place], pixels[place]]
        }).filter(seen => seen.length)""")
        cells, owners, colors = np.array(found).T
        assert len(cells) > 400
        across = np.abs((owners - cells + 80) % 160 - 80)  # around the seam
        same = (owners >= 0) & (across + np.abs(owners // 160 - cells // 160) <= 2)
        assert same.mean() > (0.97 if distance < 0.1 else 0.8)
        red, green = colors & 255, colors >> 8 & 255
        inner = same & (cells // 160 > 1) & (cells // 160 < 38) & (cells % 160 > 1) & (cells % 160 < 158)
        far_red = np.abs(red - (cells % 160 + 0.5) / 160 * 255)[inner]
        far_green = np.abs(green - (cells // 160 + 0.5) / 40 * 255)[inner]
        assert np.percentile(far_red, 97) < 8 and np.percentile(far_green, 97) < 8


@pytest.mark.parametrize("touch", [False, True], ids=["mouse", "touch"])
def test_it_flies_through_until_it_is_touched(depth, open_page, tmp_path, touch):
    data = viewer_data(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "flight")
    page = opened(open_page, tmp_path, page_of(data), has_touch=touch)
    (page.locator("#fly").tap if touch else page.locator("#fly").click)()
    page.wait_for_function("view.turn > 0.1")
    assert page.inner_text("#fly") == "stop" and page.is_checked("input[value=surfaces]")
    box = page.locator("#view").bounding_box()
    (page.touchscreen.tap if touch else page.mouse.click)(box["x"] + 40, box["y"] + 40)
    page.wait_for_function("!flight")
    assert page.inner_text("#fly") == "fly through"
    turn = page.evaluate("view.turn")
    page.wait_for_timeout(200)
    assert page.evaluate("view.turn") == turn < 6
    page.evaluate("flyTo(1)")  # it ends where it began
    assert page.evaluate("Math.cos(view.turn) > 0.999 && view.tilt < 1e-6 && view.distance < start.distance / 10")
    assert page.complaints == []


def test_who_wants_no_motion_flies_in_single_steps(depth, open_page, tmp_path):
    data = viewer_data(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "calm")
    page = opened(open_page, tmp_path, page_of(data), reduced_motion="reduce")
    turns = []
    for _ in range(3):
        page.click("#fly")
        page.wait_for_timeout(100)
        turns += [page.evaluate("view.turn"), page.evaluate("view.turn")]
    np.testing.assert_allclose(turns, 2 * np.pi / 6 * np.repeat([1, 2, 3], 2))
    assert page.inner_text("#fly") == "fly through"


@pytest.mark.parametrize(("scheme", "gray"), [("light", 0xFA), ("dark", 0x20)])
def test_it_is_light_or_dark_as_the_reader_wants(depth, open_page, tmp_path, scheme, gray):
    page_text = viewer_page(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "theme")
    page = opened(open_page, tmp_path, page_text, color_scheme=scheme)
    page.check("input[value=flat]")
    page.wait_for_selector("body[data-drawn=flat]")
    corner = page.evaluate("[...document.getElementById('view').getContext('2d').getImageData(2, 2, 1, 1).data]")
    assert corner[:3] == [gray] * 3


def test_what_is_doubtful_is_told_and_faded_and_a_slider_hides_it(depth, open_page, tmp_path):
    trust = np.full(GRID.shape, 0.9)
    trust[:, 60:100] = 0.2  # ahead
    panorama = np.full((80, 320, 3), 90, np.uint8)
    page = opened(open_page, tmp_path, viewer_page(depth, panorama, Limits(50.0, 0.0), "doubts", trust=trust))
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2 + 2, box["y"] + box["height"] / 2 + 2)
    assert page.inner_text("#readout").endswith("m, confidence 0.75, doubtful")
    colors = page.evaluate("[points.color[points.cells.indexOf(80)], points.color[points.cells.indexOf(20)]]")
    assert abs(colors[0] % 256 - 90) > 12 > 6 > abs(colors[1] % 256 - 90)  # towards the background, bright or dark
    page.check("input[value=points]")
    page.wait_for_selector("body[data-drawn=points]")
    cells = "new Set(owner).size"
    every = page.evaluate(cells)
    page.evaluate("() => { $('least').value = 128; drawPoints(); }")
    assert page.evaluate(cells) < 0.9 * every
    assert page.evaluate("owner.every(k => k < 0 || trust[k] >= 128)") and page.complaints == []


@pytest.mark.parametrize("width", [390, 1200])
def test_the_labels_of_its_scale_do_not_touch(depth, open_page, tmp_path, width):
    page = open_page(width, 900)
    ticks = [[0.0, "∞"], [0.05, "40 m"], [0.11, "20 m"], [0.22, "10 m"], [0.31, "7 m"], [0.73, "3 m"], [1.0, "2 m"]]
    data = viewer_data(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "labels") | {"ticks": ticks}
    (tmp_path / "index.html").write_text(page_of(data), encoding="utf-8")
    page.goto(f"file://{tmp_path}/index.html")
    page.wait_for_selector("body[data-drawn=look]")
    labels = [label.bounding_box() for label in page.locator("#scale span:visible").all()]
    assert len(labels) >= 4 and labels[0]["x"] >= 0 and labels[-1]["x"] + labels[-1]["width"] <= width
    assert all(left["x"] + left["width"] < right["x"] for left, right in pairwise(labels))


def test_it_is_small_and_asks_no_network(depth):
    rng = np.random.default_rng(0)
    large = osl.SphereGrid(2048, 1024, (-90, 90), min_depth=0.6)
    index = rng.uniform(0, 191, large.shape).astype(np.float32)
    index[:9] = np.nan
    noisy = osl.Depth(index, np.ones_like(index), SphereSweep(depth.sweep.rig, large))
    panorama = np.clip(rng.normal(128, 20, (1024, 2048, 3)), 0, 255).astype(np.uint8)  # no photograph is worse
    for gt_index in (None, index):
        page = viewer_page(noisy, panorama, Limits(50.0, 0.0), "large", gt_index=gt_index)
        assert len(page.encode()) < 5_000_000 and not re.search(r"https?://|src=\"|href=", page)
