"""A small data set and untrained networks."""

import pytest
import scene
import torch

import omnistereo_lib as osl


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Three frames of a rig that moves through the box, with ground truth."""
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    places = [(0.2 * number - 0.5, 0, 0.15 * number) for number in (1, 2, 3)]
    return scene.write_set(
        tmp_path_factory.mktemp("evaluate") / "box", scene.rig(width=200, height=192), grid, places
    )


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Untrained networks."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    osl.MCCNN().save(folder / "mccnn_fast.safetensors")
    osl.SweepNet().save(folder / "sweepnet.safetensors")
    return folder
