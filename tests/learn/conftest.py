"""A small data set to train on, and training on one batch."""

import pytest
import scene

import omnistereo_lib as osl
from omnistereo_learn.loop import _Run


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Four frames of a rig that moves through the box, with ground truth."""
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    places = [(0.2 * number - 0.5, 0, 0.15 * number) for number in (1, 2, 3, 4)]
    return scene.write_set(
        tmp_path_factory.mktemp("train") / "data", scene.rig(width=200, height=192), grid, places
    )


@pytest.fixture
def same_batch(monkeypatch):
    """Every step gets the first batch, whose loss must fall: that of others varies by chance."""
    draw = _Run.micro_batch
    monkeypatch.setattr(_Run, "micro_batch", lambda run, purpose, _: draw(run, purpose, 0))
