"""The viewer in a real browser, without any network: what it shows and says is the depth."""

import base64
import os
import re
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

import cv2
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.frame import read_inverse_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.judge import ray
from omnistereo_tools.output.mesh_export import is_connected
from omnistereo_tools.output.points import Limits
from omnistereo_tools.output.viewer import page_of, read_page, viewer_data, viewer_page

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)
DOUBTFUL = slice(100, 120)  # columns
WRONG = slice(40, 60)  # columns whose estimate is off by 5 % of the spheres
LIMITS = Limits(50.0, 0.0)
SIZES = {"desktop": (1000, 600), "phone": (390, 600)}


@pytest.fixture(scope="module")
def depth():
    """The exact depth of a box, with images, of which one camera is half masked."""
    rig = scene.rig(width=200, height=192)
    mask = np.ones((192, 200), bool)
    mask[:, :100] = False
    rig = replace(rig, cameras=(replace(rig.cameras[0], mask=mask), *rig.cameras[1:]))
    index = scene.true_index(rig, GRID).astype(np.float32)
    step = GRID.step
    sigma, bound, second = (np.full_like(index, value * step) for value in (0.5, 1.5, np.nan))
    second[:, 60:] = 20 * step
    sweep, confidence = SphereSweep(rig, GRID), np.full_like(index, 0.75)
    return osl.Depth(index, confidence, sweep, scene.images(rig), sigma, bound, second)


@pytest.fixture(scope="module")
def data(depth):
    rows, columns = np.indices((160, 640))
    panorama = np.stack(
        [columns * 255 // 640, rows * 255 // 160, np.full_like(rows, 128)], -1
    ).astype(np.uint8)
    trust = np.full(GRID.shape, 0.9)
    trust[:, DOUBTFUL] = 0.2
    truth = depth.index.copy()
    truth[:, WRONG] += 3.2
    return viewer_data(depth, panorama, LIMITS, "a <box>", trust=trust, gt_index=truth)


@pytest.fixture(scope="module")
def written(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "index.html"
    path.write_text(page_of(data), encoding="utf-8")
    return path.as_uri()


@pytest.fixture(scope="module")
def pages(open_page, written):
    """The page as wide as a desktop and as a telephone, which is touched."""
    return {
        name: shown(open_page(width, height, has_touch=name == "phone"), written)
        for name, (width, height) in SIZES.items()
    }


@pytest.fixture(params=SIZES)
def page(pages, request):
    return begun(pages[request.param])


@pytest.fixture
def desktop(pages):
    return begun(pages["desktop"])


def begun(page):
    """The page as it is when it has just been opened."""
    page.evaluate("""() => {
        for (const name of INPUTS) $(name).value = $(name).dataset.first
        clearTimeout(resting); detail = 1; resize()
        $("layer").onchange(); $("mix").value = 0; showWords(); $("reset").onclick(); land()
    }""")
    return in_mode(page, "look")


def shown(page, address):
    page.goto(address)
    page.wait_for_selector("body[data-drawn]")
    return page


def in_mode(page, mode):
    page.evaluate(f"document.querySelector('input[value={mode}]').checked = true; drawNow()")
    return page


def place_of(page, point):
    """Where a point is on the page."""
    box = page.locator("#view").bounding_box()
    x, y = page.evaluate("point => placeOf(point)", [float(value) for value in point])
    return box["x"] + x, box["y"] + y


def press(page, place):
    (page.touchscreen.tap if page.viewport_size["width"] < 700 else page.mouse.click)(*place)


def point_of(depth, row, column):
    return depth.depth[row, column] * depth.grid.rays()[row, column]


def line(page, y, x=0, width=None):
    """The colours that are drawn in a row of the canvas, in its pixels, (width, 3)."""
    read = page.evaluate(
        """([x, y, width]) => {
            drawNow()
            const gl = canvas.getContext("webgl2")
            const read = new Uint8Array(4 * (width ?? canvas.width))
            gl.readPixels(x, canvas.height - 1 - y, read.length / 4, 1, gl.RGBA, gl.UNSIGNED_BYTE,
                read)
            return [...read]
        }""",
        [x, y, width],
    )
    return np.array(read).reshape(-1, 4)[:, :3]


def pixel(page, x, y):
    return line(page, y, x, 1)[0].tolist()


def color_of(page, depth, row, column):
    x, y = page.evaluate(
        "point => placeOf(point).map(x => x * canvas.width / canvas.clientWidth)",
        point_of(depth, row, column).tolist(),
    )
    return pixel(page, int(x), int(y))


def test_it_shows_the_panorama_and_tells_the_depth(depth, page):
    np.testing.assert_allclose(color_of(page, depth, 20, 80), [128, 131, 128], atol=8)
    press(page, place_of(page, point_of(depth, 20, 80)))
    bound = 1 / (depth.inverse_depth[20, 80] + 1.5 * GRID.step * np.array([1, -1]))
    told = re.fullmatch(
        r"([\d.]+) m \(([\d.]+) to ([\d.]+) m\), exact ([\d.]+) m", page.inner_text("#readout")
    )
    assert [float(number) for number in told.groups()] == pytest.approx(
        [depth.depth[20, 80], *bound, depth.depth[20, 80]], abs=0.03
    )
    assert page.inner_text("#bar").startswith(f"95 % of such rays: {told[2]} to {told[3]} m")
    assert page.inner_text("#title") == "a <box>" and page.complaints == []


def test_a_second_depth_is_told_only_beyond_the_error_bars(depth, desktop):
    k, q = 20 * 160 + 80, depth.inverse_depth[20, 80]
    for spheres, is_told in ((1, False), (4, True)):
        desktop.evaluate(f"seconds[{k}] = Math.round({q + spheres * GRID.step} / D.perStep) + 1")
        assert desktop.evaluate(f"secondWords({k}).startsWith('or ')") == is_told


@pytest.mark.parametrize("mode", ["look", "flat", "points", "surfaces"])
def test_every_ray_is_found_where_it_is_shown(depth, page, mode):
    in_mode(page, mode).evaluate(
        "Object.assign(view, { turn: 0.2, tilt: 0, distance: 0.02 }); drawNow()"
    )
    missed = page.evaluate("""() => [...steps.keys()].filter(k => k % 7 === 0).map(k => {
        const density = canvas.width / canvas.clientWidth, [x, y] = placeOf(pointOf(k)) ?? [-1, -1]
        const right = canvas.clientWidth - 1, bottom = canvas.clientHeight - 1
        if (!(x > 1 && y > 1 && x < right && y < bottom)) return -1
        const at = [x, y].map(place => Math.floor(place * density))
        const found = renderer.names(seen(), settings(), ...at)[0]
        const across = Math.abs((found - k + 1.5 * D.width) % D.width - D.width / 2)
        const down = Math.abs(Math.floor(found / D.width) - Math.floor(k / D.width))
        return found < 0 ? 99 : Math.max(across, down)
    }).filter(missed => missed >= 0)""")
    assert len(missed) > 60 and np.mean(np.array(missed) <= 1) > 0.97


@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_off_the_screen_and_nothing_lies_over_another(depth, pages, size):
    page, (width, height) = begun(pages[size]), {"desktop": (1366, 768), "phone": (390, 844)}[size]
    page.set_viewport_size({"width": width, "height": height})
    for opened in (False, True):
        if opened:
            press(page, place_of(page, point_of(depth, 22, 80)))
        parts = ["#head", "#controls", *(["#why"] if opened else [])]
        boxes = [page.locator(part).bounding_box() for part in parts]
        inner = page.locator("#controls :is(label, button):visible").all()
        for box in [*boxes, *(control.bounding_box() for control in inner)]:
            assert box["x"] >= 0 and box["x"] + box["width"] <= width, box
            assert box["y"] >= 0 and box["y"] + box["height"] <= height, box
        first, last = (page.locator(one).first.bounding_box() for one in (".pick label", "#fly"))
        assert abs(first["y"] - last["y"]) < 2  # in one row
        for a, b in combinations(boxes, 2):
            apart = a["x"] + a["width"] <= b["x"] or b["x"] + b["width"] <= a["x"]
            assert apart or a["y"] + a["height"] <= b["y"] or b["y"] + b["height"] <= a["y"]
        if size == "phone":
            targets = page.locator("#stage, #controls, #why").locator("button, .pick span, select")
            shown = [target.bounding_box() for target in targets.all() if target.is_visible()]
            assert len(shown) > 4 and min(box["height"] for box in shown) >= 44
    assert page.evaluate("document.documentElement.scrollWidth") == width
    page.set_viewport_size(dict(zip(("width", "height"), SIZES[size], strict=True)))


def test_a_tap_that_opens_the_explanation_operates_nothing_that_slides_under_the_finger(pages):
    page = in_mode(begun(pages["phone"]), "look")
    page.set_viewport_size({"width": 390, "height": 844})
    frames = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.evaluate(frames)
    state = "[mode(), ...INPUTS.map(name => $(name).value), view.zoom, flight, $('why').hidden]"
    boxes = page.evaluate("""() => {
        pick(20 * D.width + 80)
        const places = "#controls :is(.pick label, input, button)"
        const found = [...document.querySelectorAll(places)].map(
            control => control.getBoundingClientRect()).map(
            box => [box.x + box.width / 2, box.y + box.height / 2])
        $("reset").onclick()
        return found
    }""")
    tapped = 0
    for x, y in boxes:
        before = page.evaluate(state)
        if page.evaluate("([clientX, clientY]) => rayAt({ clientX, clientY })", [x, y]) < 0:
            continue
        # every tap ends with a click, on a busy machine later
        page.evaluate("clicked = 0, addEventListener('click', () => ++clicked, { once: true })")
        page.touchscreen.tap(x, y)
        page.wait_for_function("clicked")
        after, tapped = page.evaluate(state), tapped + (not page.evaluate("$('why').hidden"))
        assert after[:-1] == before[:-1]
        page.evaluate("$('reset').onclick()")
        page.evaluate(frames)
    assert tapped >= 3
    page.set_viewport_size(dict(zip(("width", "height"), SIZES["phone"], strict=True)))


@pytest.mark.parametrize("width", [320, 350])
def test_the_views_are_in_one_row_within_the_page_of_a_telephone(pages, width):
    page = begun(pages["phone"])
    page.set_viewport_size({"width": width, "height": 600})
    boxes = [one.bounding_box() for one in page.locator(".pick > :is(label, button)").all()]
    assert len(boxes) == 5 and len({round(box["y"]) for box in boxes}) == 1
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)
    assert all(a["x"] + a["width"] <= b["x"] for a, b in pairwise(boxes))
    page.set_viewport_size(dict(zip(("width", "height"), SIZES["phone"], strict=True)))


def test_the_first_view_is_not_magnified_by_more_than_two(page, data):
    assert page.evaluate("focal()") * np.pi / 180 <= 2 * data[
        "pixelsPerDegree"
    ] * 1.001 or page.evaluate("canvas.clientWidth / focal() > 5.6")


@pytest.mark.parametrize("mode", ["look", "flat"])
def test_two_picks_give_the_distance_between_their_points(depth, page, mode):
    in_mode(page, mode)
    cells = (21, 76), (24, 84)
    for number, cell in enumerate(cells):
        press(page, place_of(page, point_of(depth, *cell)))
        page.evaluate("$('why').hidden = true")  # it covers some of the view
        assert page.inner_text("#distance").endswith(
            "to measure." if number == 0 else "between the two marks"
        )
    distance = np.linalg.norm(point_of(depth, *cells[0]) - point_of(depth, *cells[1]))
    told = re.match(r"([\d.]+) m ± ([\d.]+) m", page.inner_text("#distance"))
    assert float(told[1]) == pytest.approx(distance, abs=0.08)
    # Along the line between the two: each end's standard deviation, by finite differences.
    a, b = (point_of(depth, *cell) for cell in cells)
    step = 1 / GRID.min_depth / (GRID.num_spheres - 1)
    moved = [0.5] * np.array([step]) * np.array([depth.depth[cell] ** 2 for cell in cells])
    ends = [a + (a / np.linalg.norm(a)) * 1e-4, b + (b / np.linalg.norm(b)) * 1e-4]
    slopes = [
        (np.linalg.norm(ends[0] - b) - distance) / 1e-4,
        (np.linalg.norm(a - ends[1]) - distance) / 1e-4,
    ]
    error = page.evaluate("distanceBetween(...picks)[1]")
    assert error == pytest.approx(np.hypot(*(slopes * moved)), rel=0.1)
    x, y = place_of(page, point_of(depth, 20, 80))
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y)
    page.mouse.up()  # a drag picks nothing
    assert page.inner_text("#distance").endswith("between the two marks") and page.complaints == []


def test_it_shows_the_exact_depth_and_the_error(depth, desktop, data):
    colors = np.frombuffer(base64.b64decode(data["colors"]), np.uint8).reshape(-1, 3)
    in_mode(desktop, "flat").select_option("#layer", "error")
    for column, at in ((80, 0), (50, 128)):  # of 256 colours up to 10 %
        np.testing.assert_allclose(color_of(desktop, depth, 20, column), colors[at], atol=6)
    assert desktop.inner_text("#scale").endswith("10 % of spheres")
    assert desktop.inner_text("#mixWords") == "depth only"


def test_depth_has_no_stairs_but_edges(depth, open_page, tmp_path):
    index = np.tile(np.linspace(10, 12, 160, dtype=np.float32), (40, 1))  # a slope
    index[:, 100:] += 40  # and an edge
    slope = osl.Depth(index, depth.confidence, depth.sweep)
    (tmp_path / "index.html").write_text(
        viewer_page(slope, np.zeros((160, 640, 3), np.uint8), LIMITS, "slope")
    )
    page = shown(open_page(1280, 400), (tmp_path / "index.html").as_uri())
    in_mode(page, "flat").evaluate("$('mix').value = 100")
    drawn = line(page, 200)[100:1100:2].sum(1)
    jumps = np.abs(np.diff(drawn))
    edge = int(jumps.argmax())
    assert edge == pytest.approx((100 / 160 * 1280 - 100) / 2, abs=3)  # where it is, within a ray
    assert np.delete(jumps, range(edge - 3, edge + 4)).max() <= 6
    assert not page.locator("#layer").is_visible() and not page.locator("#sure").is_visible()


def test_the_explanation_of_a_ray_is_that_of_python(depth, desktop, data):
    cameras = [
        cv2.imdecode(
            np.frombuffer(base64.b64decode(camera["image"].partition(",")[2]), np.uint8), -1
        )
        for camera in data["cameras"]
    ]
    images = [np.ascontiguousarray(image[..., 2::-1]) for image in cameras]
    inverse = np.array(desktop.evaluate("[...steps.keys()].map(k => inverse(k))")).reshape(
        GRID.shape
    )
    index = GRID.inverse_depth_to_index(inverse).astype(np.float64)
    same = replace(depth, index=index, frame=images)
    kinds = set()
    for row, column in [(20, 80), (5, 10), (33, 60), (12, 130), (39, 100), (20, 0)]:
        expected = ray.explain(same, column, row)
        found = desktop.evaluate(
            """k => {
                const found = explain(k), { rival } = found
                const jump = rival ? jumpOf(depthsAround(k), found.index, rival.sphere) : 0
                return { ...found, jump, words: sentenceOf(found) }
            }""",
            row * 160 + column,
        )
        values = np.array([np.nan if x is None else x for x in found["agreement"]], float)
        np.testing.assert_allclose(values, expected.agreement, atol=1e-3)
        assert (found["sees"], found["hidden"]) == (
            expected.sees.tolist(),
            expected.hidden.tolist(),
        )
        for name in ("contrast", "shift", "chosen", "alike", "jump"):
            assert found[name] == pytest.approx(getattr(expected, name), rel=1e-3, nan_ok=True), (
                name
            )
        assert [m["sphere"] for m in found["modes"]] == [m.sphere for m in expected.modes]
        assert found["words"] == expected.sentence
        kinds.add(expected.kind)
    assert len(kinds) >= 2


def test_crosses_and_patches_follow_the_depth_along_the_ray(depth, page):
    row, column = 22, 80
    press(page, place_of(page, point_of(depth, row, column)))
    for index in (depth.index[row, column], 40):
        page.evaluate(f"$('along').value = {round(index)}; showAlong()")
        captions = page.locator("#fisheyes figcaption").all_inner_texts()
        for camera, caption in enumerate(captions):
            pixels, valid = depth.sweep.project_sphere(camera, float(index))
            place = (
                "at {:.0f}, {:.0f} px".format(*pixels[row, column])
                if valid[row, column]
                else "does not see it"
            )
            assert caption == f"camera {camera + 1} {place}"
            u, v = pixels[row, column]
            around = page.evaluate(
                "([i, u, v]) => [...fisheyes[i].canvas.getContext('2d').getImageData(u - 1, v - 1,"
                " 3, 3).data]",
                [camera, round(u - 18 if u > 100 else u + 18), round(v)],
            )
            yellow = any(
                red > 150 and blue < 100 for red, _, blue in np.reshape(around, (9, 4))[:, :3]
            )
            assert yellow or not valid[row, column]
    assert "does not see it" in " ".join(captions)
    assert page.inner_text("#alongWords").startswith(f"At {GRID.index_to_depth(40):.2f} m, ")
    page.click("#why .close")
    assert not page.locator("#why").is_visible()


def test_surfaces_have_no_hole_and_nothing_is_stretched(depth, desktop):
    in_mode(desktop, "surfaces")
    for turn in (0, 2):  # within the box, nothing hides anything
        desktop.evaluate(
            f"Object.assign(view, {{ turn: {turn}, tilt: 0, distance: 0.3 }}); drawNow()"
        )
        holes = desktop.evaluate("""() => {
            const [w, h] = [canvas.width, canvas.height]
            const names = renderer.names(seen(), settings(), w / 4, h / 2 - 100, w / 2, 200)
            return names.filter(k => k < 0).length
        }""")
        assert holes == 0
    opaque, fringe = desktop.evaluate("""() => { const mesh = makeMesh(k => steps[k] > 0)
        return [mesh.opaque, mesh.fringe].map(all => Array.from(all, i =>
            [0, 1, 5].map(value => mesh.vertices[FLOATS * i + value]))) }""")
    column, row, _ = np.reshape(opaque, (-1, 3, 3)).T  # of the corners of each
    areas = (
        (column[1] - column[0]) * (row[2] - row[0]) - (column[2] - column[0]) * (row[1] - row[0])
    ) / 2
    assert areas.min() >= 0 and areas.sum() + len(fringe) / 12 == pytest.approx(160 * 40, rel=0.01)
    assert len(areas) < 160 * 40  # flat parts have larger triangles
    inverse = np.reshape([*opaque, *fringe], (-1, 3, 3)).T[2]
    assert is_connected(1 / inverse, GRID.inverse_depth_to_index(inverse) * 0.999).all()


def test_at_an_edge_in_depth_both_surfaces_end_within_a_ray(depth, open_page, tmp_path):
    index = np.full(GRID.shape, 10.0, np.float32)
    index[10:30, 70:90] = 40  # a plate before a wall
    plate = osl.Depth(index, depth.confidence, depth.sweep)
    panorama = np.full((160, 640, 3), 60, np.uint8)
    panorama[40:120, 280:360] = 220
    (tmp_path / "index.html").write_text(viewer_page(plate, panorama, LIMITS, "plate"))
    page = in_mode(shown(open_page(800, 600), (tmp_path / "index.html").as_uri()), "surfaces")
    page.evaluate(
        "$('mix').value = 0; Object.assign(view, { turn: 0, tilt: 0, distance: 1e-3 }); drawNow()"
    )
    holes = page.evaluate(
        "renderer.names(seen(), settings(), 200, 200, 400, 200).filter(k => k < 0).length"
    )
    assert holes == 0
    drawn = line(page, 300)[200:600:2, 0]
    # no background shines through the rim
    assert set(np.unique(drawn[(drawn < 50) | (drawn > 230)])) == set()
    assert (np.abs(np.diff(drawn)) > 100).sum() <= 4


@pytest.mark.parametrize("name", ["Mesh", "Points", "Depth"])
def test_what_the_page_saves_is_read_by_others(depth, desktop, tmp_path, name):
    trimesh = pytest.importorskip("trimesh")
    desktop.evaluate("$('least').value = 4")  # what is trusted least stays out
    with desktop.expect_download() as download:
        desktop.click(f"#save{name}")
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    if name == "Depth":
        np.testing.assert_allclose(read_inverse_depth(path), depth.inverse_depth, rtol=1e-3)
        return
    found = trimesh.load(path, process=False)
    pixels, _ = GRID.project(found.vertices)
    column, row = pixels.round().astype(int).clip([0, 0], [160, 39]).T
    inside = (row > 0) & (row < 39)  # the rims of the mesh are halfway to what is not there
    assert not (np.abs(column - 110) < 9).any()  # doubtful
    length = np.linalg.norm(found.vertices, axis=1)
    np.testing.assert_allclose(
        length[inside] * depth.inverse_depth[row, column % 160][inside], 1, rtol=0.01
    )
    colors = np.asarray(found.visual.vertex_colors if name == "Mesh" else found.colors)
    np.testing.assert_allclose(
        colors[inside, 0], ((pixels[inside, 0] + 0.5) % 160) / 160 * 255, atol=8
    )
    assert len(found.vertices) > (1000 if name == "Mesh" else 5000)
    if name == "Mesh":
        away = (found.face_normals * found.triangles_center).sum(-1) > 0
        assert found.area_faces[away].sum() < 0.01 * found.area  # slivers along larger squares


def test_surfaces_begin_with_the_picture_until_the_reader_mixes(open_page, written):
    page, mix = shown(open_page(*SIZES["desktop"]), written), "+$('mix').value"
    for mode, first in (("surfaces", 0), ("look", 50), ("points", 0), ("flat", 50)):
        page.click(f"label:has([value={mode}])")
        assert page.evaluate(mix) == first
    assert page.inner_text("#leastWords") == "hide doubtful: none"
    page.fill("#mix", "30")
    page.click("#fly")
    assert page.evaluate(mix) == 30 and page.inner_text("#mixWords").startswith("70 % picture")
    assert page.complaints == []


def test_two_runs_are_compared_by_a_divider(depth, data, written, open_page, tmp_path):
    """The other run has another size and is nearer by a fifth."""
    coarse = osl.SphereGrid(80, 20, num_spheres=64, min_depth=0.6)
    index = scene.true_index(depth.sweep.rig, coarse) * 1.2
    run = osl.Depth(
        index.astype(np.float32),
        np.ones(coarse.shape, np.float32),
        SphereSweep(depth.sweep.rig, coarse),
        depth.images,
    )
    file, panorama = tmp_path / "index.html", np.zeros((40, 160, 3), np.uint8)
    file.write_text(viewer_page(run, panorama, LIMITS, "Depth from 4 cameras by another"))
    page = shown(open_page(*SIZES["desktop"]), written)
    page.set_input_files("#beside input", file)
    page.wait_for_function("!$('sides').hidden")
    # an eighth of the own rays is wrong, and of the other's what is not far away
    (name, off, made), theirs = (page.inner_text(side).split("\n") for side in ("#left", "#right"))
    assert (name, off) == ("a <box>", "13 % of rays off")
    assert theirs[0] == "another" and int(theirs[1].split()[0]) > 80
    folder, when = Path(unquote(urlsplit(written).path)).parent.name, r"\d+ \w+, \d\d:\d\d"
    assert re.fullmatch(f"{folder}, {when}", made) and re.fullmatch(when, theirs[2])
    assert page.inner_text("#title") == "a <box> against another"
    for mode in ("points", "surfaces"):  # which show the own run alone
        page.click(f"label:has([value={mode}])")
        page.wait_for_function("$('sides').hidden")
        assert page.evaluate("+$('mix').value") == 0
    page.click("label:has([value=flat])")
    page.wait_for_function("!$('sides').hidden")
    assert page.evaluate("+$('mix').value") == 100
    k = 20 * 160 + 80
    press(page, place_of(page, point_of(depth, 20, 80)))
    assert page.inner_text("#sentence") == "a <box>: " + page.evaluate("sentenceOf(why)")
    told = re.search(r"another ([\d.]+) m", page.inner_text("#readout"))
    assert float(told[1]) == pytest.approx(1 / page.evaluate(f"other.inverse[{k}]"), abs=0.01)
    assert page.evaluate(f"other.inverse[{k}]") == pytest.approx(
        1.2 * depth.inverse_depth[20, 80], rel=0.05
    )
    colors = np.frombuffer(base64.b64decode(data["colors"]), np.uint8).reshape(-1, 3)
    for divide, inverse in ((1, f"inverse({k})"), (0, f"other.inverse[{k}]")):
        page.evaluate(f"$('divide').value = {divide}; draw()")
        at = 255 * (page.evaluate(inverse) - data["low"]) / (data["high"] - data["low"])
        np.testing.assert_allclose(color_of(page, depth, 20, 80), colors[round(at)], atol=12)
    page.select_option("#layer", "apart")
    apart = page.evaluate(f"Math.abs(other.inverse[{k}] - inverse({k})) * D.percent")
    expected = colors[min(round(25.5 * apart), 255)]
    np.testing.assert_allclose(color_of(page, depth, 20, 80), expected, atol=12)
    assert page.inner_text("#facts") == "Difference between the two"
    assert not page.locator("#sides").is_visible()
    page.select_option("#layer", "estimate")
    page.locator("#sides").wait_for()
    page.focus("#divide")
    page.keyboard.press("Home")
    box, height = page.locator("#divide").bounding_box(), SIZES["desktop"][1]
    before = box["y"] + box["height"] / 2
    page.mouse.move(4, before)
    page.mouse.down()
    page.mouse.move(304, before, steps=3)
    page.mouse.up()
    assert page.evaluate("$('divide').value * canvas.clientWidth") == pytest.approx(304, abs=12)
    left, right = (page.locator(side).bounding_box() for side in ("#left", "#right"))
    assert left["x"] + left["width"] < 304 < right["x"] and right["y"] < height
    page.keyboard.press("End")
    assert page.evaluate("+$('divide').value") == 1
    (tmp_path / "other.html").write_text("something else")
    page.set_input_files("#beside input", tmp_path / "other.html")
    page.wait_for_function("$('readout').textContent.includes('not the index.html')")
    assert page.complaints == []


def test_a_run_is_put_beside_another_by_its_page(depth, data, tmp_path):
    path, panorama = tmp_path / "index.html", np.zeros((40, 160, 3), np.uint8)
    path.write_text(page_of(data), encoding="utf-8")
    both = viewer_data(depth, panorama, LIMITS, "both", beside=read_page(path))
    assert both["beside"]["title"] == "a <box>" and both["beside"]["steps"] == data["steps"]
    assert both["beside"]["made"].startswith(tmp_path.name + ", ")
    assert "picture" not in both["beside"]
    for text in ("no page", '<script id="data">{}</script>'):
        path.write_text(text)
        with pytest.raises(osl.OmnistereoError, match=r"index.html is not the page of a frame"):
            read_page(path)


@pytest.mark.skipif("AXE" not in os.environ, reason="axe-core is not there")
def test_the_page_is_read_by_ear(pages):
    for page in pages.values():
        begun(page).evaluate(
            "pick(3000); $('sides').hidden = false; $('left').textContent = 'a, b'"
        )
        page.evaluate(Path(os.environ["AXE"]).read_text())
        found = page.evaluate(
            "async () => (await axe.run()).violations.map(v => v.id + v.nodes[0].html)"
        )
        assert found == []


@pytest.mark.parametrize("key", ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"])
def test_arrows_turn_the_view(desktop, key):
    desktop.focus("#view")
    desktop.keyboard.press(key)
    yaw, pitch = desktop.evaluate("[view.yaw, view.pitch]")
    assert {
        "ArrowLeft": yaw < 0,
        "ArrowRight": yaw > 0,
        "ArrowUp": pitch < 0,
        "ArrowDown": pitch > 0,
    }[key]


def test_keys_and_the_wheel_zoom_and_enter_explains(desktop):
    desktop.focus("#view")
    desktop.keyboard.press("+")
    assert desktop.evaluate("view.zoom") == pytest.approx(1.2)
    desktop.mouse.move(600, 400)
    desktop.mouse.wheel(0, 600)
    desktop.wait_for_function("view.zoom < 1")
    desktop.keyboard.press("Enter")
    assert desktop.locator("#why").is_visible() and desktop.evaluate("picks.length") == 1


def test_a_view_can_be_sent_as_an_address(open_page, written, desktop):
    desktop.evaluate(
        "Object.assign(view, { yaw: 1, zoom: 2 }); $('mix').value = 40; pick(3000); drawNow()"
    )
    desktop.wait_for_function("location.hash.includes('rays=3000')")
    page = shown(open_page(*SIZES["desktop"]), desktop.url)
    assert page.evaluate("[view.yaw, view.zoom, +$('mix').value, ...picks]") == [1, 2, 40, 3000]
    assert (
        page.locator("#why").is_visible()
        and page.inner_text("#mixWords") == "60 % picture, 40 % depth"
    )


def test_without_webgl_it_says_so_and_shows_the_panorama(open_page, written):
    page = open_page(*SIZES["desktop"])
    page.add_init_script("""const old = HTMLCanvasElement.prototype.getContext
        HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
            return kind === "webgl2" ? null : old.call(this, kind, ...rest)
        }""")
    shown(page, written)
    assert "WebGL 2" in page.inner_text("#without") and page.locator("#without img").is_visible()
    assert page.complaints == []


def test_it_flies_through_until_it_is_touched(page):
    page.emulate_media(reduced_motion="no-preference")
    press(page, middle(page, "#fly"))
    page.wait_for_function("view.turn > 0.1")
    assert page.inner_text("#fly") == "stop" and page.is_checked("input[value=surfaces]")
    press(page, (40, 300))
    page.wait_for_function("!flight")
    assert page.inner_text("#fly") == "fly"
    page.evaluate("flyTo(1)")  # it ends where it began
    assert page.evaluate(
        "Math.cos(view.turn) > 0.999 && view.tilt < 1e-6 && view.distance < start.distance / 10"
    )
    page.emulate_media(reduced_motion="reduce")


def middle(page, selector):
    box = page.locator(selector).bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_who_wants_no_motion_flies_in_single_steps_in_the_dark(open_page, written):
    page = shown(
        open_page(*SIZES["desktop"], reduced_motion="reduce", color_scheme="dark"), written
    )
    turns = []
    for _ in range(3):
        page.click("#fly")
        turns.append(page.evaluate("view.turn"))
    np.testing.assert_allclose(turns, 2 * np.pi / 6 * np.array([1, 2, 3]))
    assert page.inner_text("#fly") == "fly"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_picture_stands_on_dark_ground_and_the_rest_is_as_the_reader_wants_it(
    open_page, written, scheme
):
    page = shown(open_page(*SIZES["desktop"], color_scheme=scheme), written)
    assert pixel(in_mode(page, "flat"), 2, 2) == [0x20] * 3
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert paper == {"light": "rgb(250, 250, 250)", "dark": "rgb(32, 32, 32)"}[scheme]


def test_what_is_doubtful_is_told_and_faded_and_a_slider_hides_it(depth, desktop):
    in_mode(desktop, "flat")
    doubtful, sure = (20, 110), (20, 70)
    press(desktop, place_of(desktop, point_of(depth, *doubtful)))
    assert desktop.inner_text("#readout").endswith(", doubtful")
    desktop.evaluate("$('why').hidden = true; $('least').value = 3; showWords()")
    assert desktop.inner_text("#leastWords") == "88 % of rays shown; 8 in 10 of them right"
    assert max(color_of(desktop, depth, *doubtful)) <= 0x3A  # the ground, hatched
    assert max(color_of(desktop, depth, *sure)) > 0x60
    assert desktop.inner_text("#key") == "hidden"  # of the picture alone nothing is grey
    desktop.evaluate("$('least').value = 0; view.turn = 0.69; view.tilt = 0; view.distance = 0.01")
    in_mode(desktop, "surfaces")
    # grey, and towards the ground
    seen = 255 * (np.array([255 * 110.5 / 160, 131, 128]) / 255) ** 0.8  # brighter
    faded = 0.6 * np.dot(seen, [0.3, 0.6, 0.1]) + 0.4 * 0x20
    red = 0.85 * faded + 0.15 * seen[0]
    assert abs(color_of(desktop, depth, *doubtful)[0] - red) < 8
    desktop.evaluate("showWords()")
    assert desktop.inner_text("#key") == (
        "doubtful: 13 %no surface here: hidden, or cut at an edge"
    )


def test_spikes_below_the_rig_are_drawn_flat_and_told_as_they_are(depth, open_page, tmp_path):
    """The ground 1.5 m below a rig, with a spike up to 0.8 m that is trusted little; one that is
    trusted stays.
    """
    grid = osl.SphereGrid(160, 80, (-90, 90), num_spheres=64, min_depth=0.6)
    sweep = SphereSweep(depth.sweep.rig, grid)
    index = grid.inverse_depth_to_index((grid.rays()[..., 1] / 1.5).clip(0)).astype(np.float32)
    spikes = (76, slice(20, 28)), (76, slice(100, 108))
    sure = np.full(grid.shape, 0.9)
    for spike in spikes:
        index[spike] = grid.inverse_depth_to_index(1 / 0.8)
    sure[76], sure[spikes[1]] = 0.5, 1.0
    ground = osl.Depth(index, np.ones(grid.shape, np.float32), sweep)
    picture = np.zeros((160, 320, 3), np.uint8)
    page = viewer_page(ground, picture, LIMITS, "ground", trust=sure)
    (tmp_path / "index.html").write_text(page)
    page = shown(open_page(800, 600), (tmp_path / "index.html").as_uri())
    around = 1 / ground.inverse_depth[76, 60]
    for column, expected in ((24, around), (104, 0.8)):
        k = 76 * 160 + column
        assert page.evaluate(f"1 / inverse({k})") == pytest.approx(0.8, rel=0.01)
        assert page.evaluate(f"1 / drawn[{k}]") == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("size", SIZES)
def test_the_labels_of_its_scale_do_not_touch(pages, size):
    page = begun(pages[size])
    page.evaluate("""() => { $("scale").querySelectorAll("span").forEach(label => label.remove())
        D.ticks = [[0, "∞"], [0.05, "40 m"], [0.11, "20 m"], [0.22, "10 m"], [0.31, "7 m"],
            [0.73, "3 m"], [1, "2 m"]]
        showScale() }""")
    labels = [label.bounding_box() for label in page.locator("#scale span:visible").all()]
    assert len(labels) >= 3
    assert all(left["x"] + left["width"] < right["x"] for left, right in pairwise(labels))


def test_it_is_small_and_asks_no_network(depth):
    rng = np.random.default_rng(0)
    large = osl.SphereGrid(2048, 1024, (-90, 90), min_depth=0.6)
    index = rng.uniform(0, 191, large.shape).astype(np.float32)
    index[:9] = np.nan
    noisy = osl.Depth(index, np.ones_like(index), SphereSweep(depth.sweep.rig, large))
    # no photograph is worse
    panorama = np.clip(rng.normal(128, 20, (1024, 2048, 3)), 0, 255).astype(np.uint8)
    for gt_index in (None, index):
        page = viewer_page(noisy, panorama, LIMITS, "large", gt_index=gt_index)
        assert len(page.encode()) < 5_000_000
        assert not re.search(r"(https?://(?!www\.w3\.org/2000/svg)|src=\"|href=)", page)
