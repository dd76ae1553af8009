"""Wrong arguments that `bad_inputs.py` does not have: each gets the library's error, at once, and says why."""

import numpy as np
import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_lib.train.recipes import SweepNetRecipe

RIG = scene.rig(width=60, height=56)
GRID = osl.SphereGrid(48, 12, num_spheres=4, min_depth=0.6)
IMAGES = [np.random.default_rng(k).integers(0, 255, (56, 60), np.uint8) for k in range(4)]
VOLUME = np.random.default_rng(0).random((6, 8, 4), np.float32)


def depth(images=IMAGES, **options):
    return osl.estimate_depth(RIG, images, GRID, **options)


def rig(pose=0.0, min_depth=None):
    return osl.Rig(RIG.cameras, [osl.Pose(np.eye(3), [pose, 0, 0])] * 4, min_depth)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: osl.SphereGrid(96, 1_000_000_000), "height is 1000000000"),
        (lambda: osl.SphereSweep(RIG, GRID, device=5.5), "device is 5.5"),
        (lambda: depth([None] * 4), "image 1 has shape"),
        (lambda: depth([*IMAGES[:3], np.zeros((56, 60), complex)]), "image 4 has type complex128"),
        (lambda: osl.ZNCC(window="9"), "window is '9'"),
        (lambda: rig(1e8), r"camera 1 .* 100000000.0; expected a number of 0 to 1"),
        (lambda: rig(min_depth=-1.0), "min_depth.* is -1.0"),
        (lambda: rig(min_depth=np.nan), "min_depth.* is nan"),
        (lambda: sgm(torch.from_numpy(VOLUME + 1j)), "type torch.complex64; expected"),
        (lambda: sgm(None), "holds object"),
        (lambda: sgm(VOLUME, p1="0.1"), "p1 = '0.1'"),
        (lambda: osl.winner_takes_all(VOLUME[..., :1]), "expected .* N ≥ 2"),
        (lambda: osl.confidence("abc"), "the cost volume holds"),
        (lambda: SweepNetRecipe(steps=2.5), "steps = 2.5; expected"),
        (lambda: SweepNetRecipe(learning_rate="1"), "learning_rate = '1'; expected a finite number > 0"),
        (lambda: SweepNetRecipe(learning_rate=np.inf), "learning_rate = inf"),
        (lambda: SweepNetRecipe(momentum=np.nan), "momentum = nan; expected a fraction"),
        (lambda: SweepNetRecipe(warmup=-5), "warmup = -5"),
        (lambda: SweepNetRecipe(seed=-1), "seed = -1"),
        (lambda: SweepNetRecipe(spheres_per_frame=-1), "spheres_per_frame = -1"),
    ],
)  # fmt: skip
def test_wrong_arguments(call, message):
    with pytest.raises(osl.OmnistereoError, match=message) as error:
        call()
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    "change",
    [
        lambda volume: volume[:, ::-1][:, ::-1],
        lambda volume: np.ascontiguousarray(volume[::-1])[::-1],
        lambda volume: volume.astype(">f4"),
        lambda volume: np.asfortranarray(volume),
        lambda volume: volume.astype(np.float64),
        lambda volume: torch.from_numpy(volume).requires_grad_(),
    ],
)
def test_volumes_of_any_layout(change):
    torch.testing.assert_close(sgm(change(VOLUME)), sgm(VOLUME), rtol=0, atol=0)
    assert (osl.winner_takes_all(change(VOLUME)) == osl.winner_takes_all(VOLUME)).all()


def test_images_may_be_tensors_with_gradients():
    tensors = [torch.from_numpy(image).float().requires_grad_() for image in IMAGES]
    sweep = osl.SphereSweep(RIG, GRID)
    np.testing.assert_array_equal(sweep_depth(sweep, tensors).index, sweep_depth(sweep, IMAGES).index)
