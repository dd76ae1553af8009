"""Pictures in notebooks: small, the same every time, described."""

import base64

import cv2
import matplotlib
import numpy as np
import pytest
import scene
from matplotlib import pyplot as plt

import omnistereo_lib as osl
from course.figures import plot
from omnistereo_tools.output.colors import BACKGROUND, colorize_depth

matplotlib.use("agg")


@pytest.fixture
def figure():
    fig, ax = plt.subplots(figsize=(4, 2))
    ax.imshow(np.random.default_rng(0).integers(0, 256, (80, 160, 3), dtype=np.uint8))
    return fig


@pytest.mark.parametrize(("kind", "magic"), [("png", b"\x89PNG\r\n"), ("jpeg", b"\xff\xd8\xff")])
def test_encode_depends_on_the_picture_alone(figure, kind, magic):
    data = plot.encode(figure, kind)
    assert data.startswith(magic)
    assert data == plot.encode(figure, kind)
    assert matplotlib.__version__.encode() not in data


def test_show_publishes_picture_description_and_caption_and_closes(figure, monkeypatch):
    shown = []
    monkeypatch.setattr(
        "IPython.display.display", lambda data, **options: shown.append((data, options))
    )
    expected = plot.encode(figure, "jpeg")
    entry = {"caption": "All *noise*.", "alt": "a rectangle of coloured noise", "kind": "jpeg"}
    monkeypatch.setattr(plot, "captions", lambda: {"noise": entry})
    plot.show(figure, "noise")
    (picture, options), (caption, _) = shown
    assert base64.b64decode(picture["image/jpeg"]) == expected
    assert (
        picture["text/plain"]
        == options["metadata"]["image/jpeg"]["alt"]
        == "a rectangle of coloured noise"
    )
    assert caption["text/markdown"] == "*Figure:* All *noise*."
    assert not plt.fignum_exists(figure.number)


GRID = osl.SphereGrid(64, 16, (-30, 45), 32, 0.5)


def test_depth_colours_get_brighter_towards_the_viewer_and_unknown_is_striped_gray():
    inverse_depth = np.tile(np.linspace(0, 1 / GRID.min_depth, 64), (16, 1))
    inverse_depth[:, 40:] = np.nan
    picture = colorize_depth(inverse_depth, GRID).astype(int)
    lightness = picture[0, :40] @ [0.299, 0.587, 0.114]
    assert (np.diff(lightness) > 0).all()
    assert set(map(tuple, picture[:, 40:].reshape(-1, 3))) == {(170, 170, 170), (200, 200, 200)}


def test_panoramas_are_drawn_with_their_angles():
    fig, ax = plt.subplots()
    picture = np.full((16, 64, 3), 300.0)
    picture[0] = np.nan
    image = plot.draw_panorama(ax, picture, GRID)
    assert image.get_extent() == [-180, 180, 45, -30]
    assert image.get_array()[0].max() == 185 and image.get_array()[1:].min() == 255
    assert [float(tick) for tick in ax.get_yticks()] == [-30, 0, 45]
    plt.close(fig)


def test_the_colour_bar_of_depth_is_in_metres():
    fig, ax = plt.subplots()
    plot.draw_depth(ax, np.zeros(GRID.shape), GRID)
    labels = [label.get_text() for label in fig.axes[1].get_yticklabels()]
    assert labels == ["∞", "2 m", "1 m", "0.5 m"]
    plt.close(fig)


def test_a_rig_is_drawn_from_above():
    fig, ax = plt.subplots()
    rig = scene.rig()
    plot.draw_rig(ax, rig)
    drawn = np.array([line.get_xydata()[0] for line in ax.lines[: len(rig)]])
    np.testing.assert_allclose(drawn, rig.centers[:, [0, 2]])
    plt.close(fig)


def test_a_live_figure_follows_its_sliders(monkeypatch):
    from ipywidgets import FloatSlider, IntSlider

    shown, drawn, open_before = [], [], plt.get_fignums()
    monkeypatch.setattr("IPython.display.display", shown.append)

    def draw(n, gain):
        drawn.append((n, gain))
        fig, ax = plt.subplots(figsize=(2, 1))
        ax.imshow(np.full((4, 4), gain), vmin=0, vmax=n)
        return fig

    plot.interactive(draw, n=IntSlider(3), gain=FloatSlider(1.0))
    n, _, picture = shown[0].children
    before = bytes(picture.value)
    n.value = 7
    assert drawn == [(3, 1.0), (7, 1.0)]
    assert before.startswith(b"\xff\xd8\xff") and bytes(picture.value) != before
    assert n.description == "n" and plt.get_fignums() == open_before


def test_a_click_moves_the_cross_and_asks_that_ray(monkeypatch):
    shown, drawn, clicked = [], [], []
    monkeypatch.setattr("IPython.display.display", shown.append)
    monkeypatch.setattr(
        "ipyevents.Event.on_dom_event", lambda event, callback: clicked.append(callback)
    )

    def draw(row, column):
        drawn.append((row, column))
        return plt.figure(figsize=(2, 1))

    panorama = np.full((8, 32), 100.0)
    panorama[0, 0] = np.nan
    plot.pick_ray(draw, panorama, 2, 5)
    picture, below = shown
    row, column, figure = below.children
    before = cv2.imdecode(np.frombuffer(picture.value, np.uint8), cv2.IMREAD_COLOR)
    size = {"boundingRectWidth": 640.0, "boundingRectHeight": 160.0}
    clicked[0]({"relativeX": 300.0, "relativeY": 149.9} | size)
    after = cv2.imdecode(np.frombuffer(picture.value, np.uint8), cv2.IMREAD_COLOR)
    assert (row.value, column.value) == (7, 15) and drawn[0] == (2, 5) and drawn[-1] == (7, 15)
    assert before.shape == (24, 96, 3) and (before != after).any()
    column.value = 0
    assert drawn[-1] == (7, 0) and bytes(figure.value).startswith(b"\xff\xd8\xff")


def test_points_are_seen_from_the_eye():
    """Red 1 m down (+y), green 1 m right (+x), seen from behind; blue is behind the eye."""
    rng = np.random.default_rng(0)
    places = {(0, 1, 0): (255, 0, 0), (1, 0, 0): (0, 255, 0), (0, 0, -8): (0, 0, 255)}
    points = np.concatenate([rng.normal(place, 0.1, (300, 3)) for place in places])
    colors = np.repeat(np.uint8(list(places.values())), 300, axis=0)
    picture = plot.draw_points(points, colors, size=(300, 200), eye=(0, 0, -4))
    red, green, blue = ((picture == color).all(-1).nonzero() for color in places.values())
    assert picture.shape == (200, 300, 3) and len(blue[0]) == 0
    focal = 0.62 * 300  # px
    assert np.mean(red, 1) == pytest.approx([100 + focal / 4, 150], abs=2)
    assert np.mean(green, 1) == pytest.approx([100, 150 + focal / 4], abs=2)
    assert (plot.draw_points(points[:0], colors[:0], (4, 3), (0, 0, -4)) == BACKGROUND).all()


def test_near_points_hide_far_ones():
    points, colors = np.array([[0, 0, 0], [0, 0, 1.0]]), np.uint8([[255, 0, 0], [0, 255, 0]])
    for order in ([0, 1], [1, 0]):
        picture = plot.draw_points(points[order], colors[order], (40, 30), (0, 0, -1.0))
        assert (picture == [255, 0, 0]).all(-1).any()
