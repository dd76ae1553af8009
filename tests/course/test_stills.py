"""What the website shows beside text: pictures for dark pages, stills of live figures, point clouds that turn."""

import io
import json

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pytest
from ipywidgets import FloatLogSlider, FloatSlider, IntSlider
from PIL import Image

import omnistereo_lib as osl
from course import pictures, plot, stills, view3d
from course.cloud import MAX_POINTS, cloud_page, thinned

RNG = np.random.default_rng(0)


# --- Dark pages ---------------------------------------------------------------------------------------------


def figure():
    """A white page with a photograph, a line drawing in a frame and a word, and where the photograph is."""
    page = np.full((300, 400, 3), 255, np.uint8)
    photograph = np.s_[20:140, 20:180]
    page[photograph] = RNG.integers(0, 230, (120, 160, 3))
    cv2.rectangle(page, (220, 20), (380, 140), (0, 0, 0), 1)
    cv2.line(page, (230, 130), (370, 30), (31, 119, 180), 3)
    cv2.putText(page, "metres", (100, 250), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (0, 0, 0), 2)
    return page, photograph


def test_paper_gets_dark_ink_light_and_a_photograph_stays():
    page, photograph = figure()
    dark = pictures.for_dark_page(page)
    np.testing.assert_array_equal(dark[photograph], page[photograph])
    rest = np.ones(page.shape[:2], bool)
    rest[photograph] = False
    assert (dark[rest & (page == 255).all(-1)] == pictures.PAPER).all()
    assert (dark[rest & (page == 0).all(-1)] == pictures.INK).all()


def test_a_line_keeps_its_hue_and_is_seen_on_dark_paper():
    dark = pictures.for_dark_page(np.tile(np.uint8([31, 119, 180]), (4, 4, 1)))[0, 0]
    hue = [cv2.cvtColor(np.uint8([[color]]), cv2.COLOR_RGB2HSV)[0, 0, 0] for color in ([31, 119, 180], dark)]
    assert abs(int(hue[0]) - int(hue[1])) <= 2
    assert dark.max() > 150


# --- Stills -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("slider", "count", "expected"),
    [
        (IntSlider(10, 0, 63), 4, [0, 10, 42, 63]),
        (IntSlider(1, 0, 2), 9, [0, 1, 2]),
        (FloatSlider(0.25, min=-1, max=1, step=0.25), 3, [-1, 0.25, 1]),
        (FloatLogSlider(12, min=-2, max=2), 5, [0.01, 0.1, 1, 12, 100]),
    ],
)
def test_places_are_spread_over_the_slider_and_hold_its_own(slider, count, expected):
    found = stills.places(slider, count)
    assert found == pytest.approx(expected)
    assert type(found[0]) is type(slider.value)


@pytest.fixture
def recorded(tmp_path, monkeypatch):
    """The folder in which live figures of a notebook called "tiny" are stored."""
    monkeypatch.setattr(stills, "STILLS", tmp_path)
    monkeypatch.setenv(stills.VARIABLE, str(tmp_path / "tiny"))
    return tmp_path / "tiny"


def test_a_live_figure_is_stored_at_its_places_and_shown(recorded, tmp_path):
    def draw(gain, n):
        drawn.append((gain, n))
        fig = plt.figure(figsize=(2, 1), facecolor=str(n / 10))
        return fig

    drawn, open_before = [], plt.get_fignums()
    plot.interactive(draw, gain=FloatSlider(0, min=0, max=2, step=1), n=IntSlider(5, 0, 10, 5))
    assert drawn == [(0, 5), (1, 5), (2, 5), (0, 0), (0, 10)] and plt.get_fignums() == open_before
    names = [f"0-{name}.webp" for name in ("gain-0", "gain-1", "gain-2", "n-0", "n-2")]
    assert sorted(path.name for path in recorded.glob("*.webp")) == names
    gray = np.asarray(Image.open(recorded / "0-n-2.webp")).mean()
    assert gray > 250 > 10 > np.asarray(Image.open(recorded / "0-n-0.webp")).mean()

    html = stills.shown("tiny", 0, tmp_path / "out", "../")
    assert html.count("<input") == 2 and html.count("<img") == 2 * 5 and html.count(" hidden>") == 4
    assert len(list((tmp_path / "out" / pictures.FOLDER).iterdir())) == 2 * 3  # n = 5 is always the same picture


def test_a_click_on_a_panorama_is_stored_with_its_figure(recorded):
    plot.pick_ray(lambda row, column: plt.figure(figsize=(2, 1)), np.full((8, 32), 100.0), 2, 5)
    assert [slider["name"] for slider in json.loads((recorded / "index.json").read_text())[0]["sliders"]] == [
        "row",
        "column",
    ]
    still = Image.open(io.BytesIO((recorded / "0-row-2.webp").read_bytes()))
    assert still.width / still.height == pytest.approx(900 / (225 + 450), rel=0.1)  # the panorama above the figure


def test_a_live_figure_without_stills(recorded):
    with pytest.raises(osl.OmnistereoError, match=r"Run: python -m course stills notebooks/tiny.ipynb"):
        stills.shown("tiny", 0, recorded)


# --- Point clouds -------------------------------------------------------------------------------------------


def test_a_cloud_is_thinned_always_to_the_same_points():
    points, colors = RNG.normal(size=(MAX_POINTS + 1000, 3)), RNG.integers(0, 255, (MAX_POINTS + 1000, 3), np.uint8)
    first, again = thinned(points, colors), thinned(points, colors)
    assert len(first[0]) == MAX_POINTS and (first[0] == again[0]).all()
    row = np.flatnonzero((points == first[0][7]).all(1))
    assert (colors[row] == first[1][7]).all()


def test_a_cloud_is_stored_and_shown(recorded, tmp_path):
    view3d.explore(RNG.normal(size=(10, 3)), np.zeros((10, 3), np.uint8), (0, -1, -4))
    assert 'src="clouds/tiny-0.html"' in stills.shown("tiny", 0, tmp_path)
    assert "cloud of 10 points" in (tmp_path / "clouds" / "tiny-0.html").read_text(encoding="utf-8")


SEEN = """() => {
    const canvas = document.querySelector("canvas"), {width, height} = canvas
    const {data} = canvas.getContext("2d").getImageData(0, 0, width, height)
    const seen = [[0, 0, 0], [0, 0, 0]]  // red, green: count, sum of u, sum of v
    for (let i = 0; i < width * height; i++) for (const c of [0, 1]) if (data[4 * i + c] > 200) {
        seen[c][0]++; seen[c][1] += i % width; seen[c][2] += Math.floor(i / width)
    }
    return seen.map(([n, u, v]) => [n, u / n, v / n])
}"""


def test_a_cloud_shows_what_pyvista_would_and_turns_tilts_and_zooms(open_page, tmp_path):
    """Red 1 m down (+y), green 1 m to the right (+x), seen from behind; the oracle is the picture of `draw_points`."""
    red, green = RNG.normal((0, 1, 0), 0.03, (300, 3)), RNG.normal((1, 0, 0), 0.03, (300, 3))
    points, colors = np.concatenate([red, green]), np.repeat(np.uint8([[255, 0, 0], [0, 255, 0]]), 300, 0)
    path = tmp_path / "cloud.html"
    path.write_text(cloud_page(points, colors, (1, -2, -6)), encoding="utf-8")
    page = open_page(600, 400)
    page.goto(path.as_uri())
    page.wait_for_function("() => document.querySelector('canvas').width === 600")
    seen = page.evaluate(SEEN)
    drawn = view3d.draw_points(points, colors, (1, -2, -6), size=(600, 400))
    for c in (0, 1):
        rows, columns = (drawn[..., c] > 200).nonzero()
        assert seen[c][1:] == pytest.approx([columns.mean(), rows.mean()], abs=3)

    def after(act):
        act()
        page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        return page.evaluate(SEEN)

    page.locator("canvas").focus()
    turned = after(lambda: [page.keyboard.press("ArrowRight") for _ in range(8)])
    assert turned[1][1] < seen[1][1] - 20
    near = after(lambda: [page.keyboard.press("+") for _ in range(5)])
    assert near[0][2] > turned[0][2] + 20  # what is below the middle moves out
    assert after(lambda: page.keyboard.press("r")) == seen
    page.mouse.move(300, 200)
    page.mouse.down()
    assert after(lambda: page.mouse.move(300, 350))[0][2] < seen[0][2] - 20  # from above, down is nearer to the middle
    assert page.complaints == []
