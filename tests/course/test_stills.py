"""What the website shows beside text: dark pictures, stills of live figures, the viewer."""

import io
import json

import cv2
import matplotlib.pyplot as plt
import numpy as np
import pytest
import scene
from ipywidgets import FloatLogSlider, FloatSlider, IntSlider, SelectionSlider
from PIL import Image
from scene import refused

import omnistereo_lib as osl
from course.figures import dark_mode, plot, stills

RNG = np.random.default_rng(0)


# --- Dark pages


def figure():
    """A page with a photograph, a framed line drawing and a word; where the photograph is."""
    page = np.full((300, 400, 3), 255, np.uint8)
    photograph = np.s_[20:140, 20:180]
    page[photograph] = RNG.integers(0, 230, (120, 160, 3))
    cv2.rectangle(page, (220, 20), (380, 140), (0, 0, 0), 1)
    cv2.line(page, (230, 130), (370, 30), (31, 119, 180), 3)
    cv2.putText(page, "metres", (100, 250), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (0, 0, 0), 2)
    return page, photograph


def test_paper_gets_dark_ink_light_and_a_photograph_stays():
    page, photograph = figure()
    dark = dark_mode.for_dark_page(page)
    np.testing.assert_array_equal(dark[photograph], page[photograph])
    rest = np.ones(page.shape[:2], bool)
    rest[photograph] = False
    assert (dark[rest & (page == 255).all(-1)] == dark_mode.PAPER).all()
    assert (dark[rest & (page == 0).all(-1)] == dark_mode.INK).all()


def test_a_line_keeps_its_hue_and_is_seen_on_dark_paper():
    dark = dark_mode.for_dark_page(np.tile(np.uint8([31, 119, 180]), (4, 4, 1)))[0, 0]
    colors = np.uint8([[[31, 119, 180], dark]])
    hue = [*cv2.cvtColor(colors, cv2.COLOR_RGB2HSV)[0, :, 0]]
    assert abs(int(hue[0]) - int(hue[1])) <= 2
    assert dark.max() > 150


# --- Stills


@pytest.mark.parametrize(
    ("slider", "count", "expected"),
    [
        (IntSlider(10, 0, 63), 4, [0, 10, 42, 63]),
        (IntSlider(1, 0, 2), 9, [0, 1, 2]),
        (FloatSlider(0.25, min=-1, max=1, step=0.25), 3, [-1, 0.25, 1]),
        (FloatLogSlider(12, min=-2, max=2), 5, [0.01, 0.1, 1, 12, 100]),
        (SelectionSlider(options=[("far", 3), ("near", 5), ("at hand", 7)], value=5), 3, [3, 5, 7]),
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
    # n = 5 is always the same picture
    assert len(list((tmp_path / "out" / dark_mode.FOLDER).iterdir())) == 2 * 3


def test_a_slider_over_labels_shows_them(recorded, tmp_path):
    slider = SelectionSlider(options=[("0, ∞", 0), ("1, 5 m", 1)], value=1)
    plot.interactive(lambda n: plt.figure(figsize=(2, 1)), n=slider)
    html = stills.shown("tiny", 0, tmp_path)
    assert "<output>1, 5 m</output>" in html and 'alt="The live figure at n = 0, ∞"' in html


def test_a_click_on_a_panorama_is_stored_with_its_figure(recorded):
    plot.pick_ray(lambda row, column: plt.figure(figsize=(2, 1)), np.full((8, 32), 100.0), 2, 5)
    assert [
        slider["name"] for slider in json.loads((recorded / "index.json").read_text())[0]["sliders"]
    ] == ["row", "column"]
    still = Image.open(io.BytesIO((recorded / "0-row-2.webp").read_bytes()))
    # the panorama above the figure
    assert still.width / still.height == pytest.approx(900 / (225 + 450), rel=0.1)


def test_a_live_figure_without_stills(recorded):
    with refused(r"Run: python -m workshop stills notebooks/tiny.ipynb"):
        stills.shown("tiny", 0, recorded)


# --- Viewer


def test_a_view_is_stored_and_begins_with_its_points(recorded, tmp_path, open_page):
    rig = scene.rig(width=80, height=64)
    grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=0.6)
    images = [np.full((64, 80), 200, np.uint8)] * 4
    depth = scene.true_depth(rig, grid, images)
    plot.explore(depth, max_depth=50)
    assert 'src="../views/tiny-0.html"' in stills.shown("tiny", 0, tmp_path, "../")
    page = open_page(900, 800)
    page.goto((tmp_path / "views" / "tiny-0.html").as_uri())
    page.wait_for_selector("body[data-drawn=points]")
    shown = page.evaluate(
        "[...new Set(renderer.names(seen(), settings(), 0, 0, canvas.width, canvas.height))]"
    )
    assert len(shown) > 200 and (depth.depth.ravel()[[k for k in shown if k >= 0]] <= 50).all()
    assert page.complaints == []
