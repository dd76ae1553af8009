"""A small data set and untrained networks."""

import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_lib.dataset import write_inverse_depth
from omnistereo_lib.files import write_image


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Three frames of a rig that moves through the box, with ground truth."""
    folder = tmp_path_factory.mktemp("evaluate") / "box"
    folder.mkdir()
    rig = scene.rig(width=200, height=192)
    osl.Rig(rig.cameras, rig.T_rig_cam, min_depth=0.6).save(folder / "config.yaml")
    grid = osl.SphereGrid(96, 24, (-45, 45), 12, 0.6)
    (folder / "omnidepth_gt_96").mkdir()
    for number in (1, 2, 3):
        step = osl.Pose.from_vector([0, 0, 0, 0.2 * number - 0.5, 0, 0.15 * number])
        moved = osl.Rig(rig.cameras, [step @ pose for pose in rig.T_rig_cam])
        for k, image in enumerate(scene.images(moved, finest=0.25), 1):
            (folder / f"cam{k}").mkdir(exist_ok=True)
            write_image(folder / f"cam{k}" / f"{number:04}.png", image)
        inverse_depth = grid.index_to_inverse_depth(scene.true_index(moved, grid))
        write_inverse_depth(folder / "omnidepth_gt_96" / f"{number:05}.tiff", inverse_depth)
    return folder


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Untrained networks."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    osl.MCCNN().save(folder / "mccnn_fast.safetensors")
    osl.SweepNet().save(folder / "sweepnet.safetensors")
    return folder
