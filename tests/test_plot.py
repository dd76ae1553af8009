"""Pictures in notebooks: small, the same every time, described."""

import base64

import matplotlib
import numpy as np
import pytest

from omnistereo_lib import plot

matplotlib.use("agg")


@pytest.fixture
def figure():
    from matplotlib import pyplot as plt

    fig, ax = plt.subplots(figsize=(4, 2))
    ax.imshow(np.random.default_rng(0).integers(0, 256, (80, 160, 3), dtype=np.uint8))
    return fig


@pytest.mark.parametrize(("kind", "magic"), [("png", b"\x89PNG\r\n"), ("jpeg", b"\xff\xd8\xff")])
def test_encode_depends_on_the_picture_alone(figure, kind, magic):
    data = plot.encode(figure, kind)
    assert data.startswith(magic)
    assert data == plot.encode(figure, kind)
    assert matplotlib.__version__.encode() not in data


def test_a_photograph_is_smaller_as_jpeg(figure):
    assert len(plot.encode(figure, "jpeg")) < 0.7 * len(plot.encode(figure, "png"))


def test_show_publishes_picture_description_and_caption_and_closes(figure, monkeypatch):
    from matplotlib import pyplot as plt

    shown = []
    monkeypatch.setattr("IPython.display.display", lambda data, **options: shown.append((data, options)))
    expected = plot.encode(figure, "jpeg")
    plot.show(figure, "All *noise*.", "a rectangle of coloured noise", kind="jpeg")
    (picture, options), (caption, _) = shown
    assert base64.b64decode(picture["image/jpeg"]) == expected
    assert picture["text/plain"] == options["metadata"]["image/jpeg"]["alt"] == "a rectangle of coloured noise"
    assert caption["text/markdown"] == "*Figure:* All *noise*."
    assert not plt.fignum_exists(figure.number)
