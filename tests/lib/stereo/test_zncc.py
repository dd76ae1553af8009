import numpy as np
import pytest
import torch
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib import reference


def in_float64(images, pairs, window):
    """The definition, (H, W, B)."""
    costs = [reference.zncc(images[i].double(), images[j].double(), window) for i, j in pairs]
    return reference.mean_over_pairs(torch.stack(costs)).permute(1, 2, 0)


def block(kind, cameras=3, B=2, H=13, W=17, seed=0):
    rng = np.random.default_rng(seed)
    images = rng.normal(size=(cameras, B, H, W))
    if kind == "flat":
        images = np.full_like(images, 2.0)
    if kind == "nearly flat":  # where float32 box sums leave [-1, 1]
        images = 2.0 + 1e-2 * images
    if kind == "partly visible":
        images[rng.random(images.shape) < 0.3] = np.nan
    if kind == "strips":
        images[0, :, :, 5:9] = images[1, :, :, 12:] = images[2] = np.nan
    return images.astype(np.float32)


@pytest.mark.parametrize("kind", ["textured", "flat", "nearly flat", "partly visible", "strips"])
@pytest.mark.parametrize("window", [3, 5, 9])
def test_cost_agrees_with_the_definition(kind, window):
    images, pairs = torch.from_numpy(block(kind)), [(0, 1), (1, 2), (2, 0)]
    np.testing.assert_allclose(
        osl.ZNCC(window)(images, pairs), in_float64(images, pairs, window), atol=1e-5
    )


def test_a_device_without_a_kernel_takes_the_definition():
    images = torch.from_numpy(block("textured")).to("meta")
    assert osl.ZNCC(5)(images, [(0, 1)]).shape == (13, 17, 2)


def test_invisible_columns_may_be_skipped():
    images = block("textured", cameras=2)
    images[0, ..., 3:6] = images[1, ..., 10:] = np.nan
    images = torch.from_numpy(images)
    everywhere = osl.ZNCC()(images, [(0, 1)])
    skipped = osl.ZNCC()(images, [(0, 1)], [(6, 14), (0, 10)])
    assert torch.equal(everywhere.nan_to_num(9), skipped.nan_to_num(9))


def test_windows_must_fit_the_panorama():
    with refused("window is 15; expected at most the panorama size 17 × 13"):
        osl.ZNCC(15)(torch.from_numpy(block("textured")), [(0, 1)])


def test_more_spheres_rows_and_columns_than_are_computed_at_a_time():
    images = torch.from_numpy(block("partly visible", cameras=2, B=18, H=43, W=300))
    expected = in_float64(images, [(0, 1)], 9)
    threads = torch.get_num_threads()
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            np.testing.assert_allclose(osl.ZNCC(9)(images, [(0, 1)]), expected, atol=1e-5)
    finally:
        torch.set_num_threads(threads)
