"""MC-CNN against itself one patch at a time, in float64, and against its published sizes."""

import numpy as np
import pytest
import torch
from scene import refused
from torch.nn.functional import conv2d, linear

import omnistereo_lib as osl
from omnistereo_lib.stereo.learned import LearnedCost

RING = [(0, 1), (1, 2), (2, 0)]


def network(variant):
    torch.manual_seed(0)
    net = osl.MCCNN(variant).eval()
    for layer in [*net.tower, *net.head]:
        torch.nn.init.normal_(layer.bias, std=0.1)
    if variant == "accurate":
        torch.nn.init.normal_(net.head[-1].weight, std=0.05)
    return net


def images(cameras=3, B=1, H=10, W=24, seed=0):
    rng = np.random.default_rng(seed)
    picture = rng.normal(size=(cameras, B, H, W)).astype(np.float32)
    columns = [((9 * k - 3) % W, 15) for k in range(cameras)]
    for k, (start, width) in enumerate(columns):
        picture[k, :, :, (start + np.arange(width, W)) % W] = np.nan
    picture[rng.random(picture.shape) < 0.05] = np.nan
    return torch.from_numpy(picture), columns


def patch_by_patch(net, spherical, pairs):
    """The cost of every pixel from the two 9 × 9 patches around it, cut out one by one."""
    weights = {name: w.double() for name, w in net.state_dict().items()}
    layers = sum(name.startswith("head") for name in weights) // 2
    _, B, H, W = spherical.shape
    padded = torch.zeros(*spherical.shape[:2], H + 8, W + 8, dtype=torch.float64)
    padded[:, :, 4:-4] = spherical.double().nan_to_num()[..., (torch.arange(W + 8) - 4) % W]

    def describe(patch):
        for k in range(4):
            patch = conv2d(patch, weights[f"tower.{k}.weight"], weights[f"tower.{k}.bias"])
            patch = patch.relu() if k < 3 or net.variant == "accurate" else patch
        return patch.flatten()

    def cost(a, b):
        if net.variant == "fast":
            return (1 - a @ b / (a.norm() * b.norm())) / 2
        x = torch.cat([a, b])
        for k in range(layers):
            x = linear(x, weights[f"head.{k}.weight"], weights[f"head.{k}.bias"])
            x = x.relu() if k < layers - 1 else x.sigmoid()
        return x[0]

    out = torch.full((H, W, B), torch.nan, dtype=torch.float64)
    for n, y, x in np.ndindex(B, H, W):
        seen = [
            (i, j) for i, j in pairs if not (spherical[i, n, y, x] + spherical[j, n, y, x]).isnan()
        ]
        patches = padded[:, n, None, None, y : y + 9, x : x + 9]
        if seen:
            out[y, x, n] = torch.stack(
                [cost(describe(patches[i]), describe(patches[j])) for i, j in seen]
            ).mean()
    return out


@pytest.mark.parametrize("variant, expected", [("fast", 111_424), ("accurate", 870_449)])
def test_parameters_are_the_published_ones(variant, expected):
    assert sum(p.numel() for p in osl.MCCNN(variant).parameters()) == expected


def test_a_camera_that_sees_nothing_changes_nothing():
    cost, (spherical, columns) = LearnedCost(network("fast"), "float32"), images()
    spherical[2] = torch.nan
    found = cost(spherical, RING, [*columns[:2], (0, 0)])
    torch.testing.assert_close(found, cost(spherical[:2], [(0, 1)], columns[:2]), equal_nan=True)


@pytest.mark.parametrize("variant", ["fast", "accurate"])
def test_whole_panoramas_equal_patch_by_patch(variant):
    net, (spherical, columns) = network(variant), images()
    expected = patch_by_patch(net, spherical, RING)
    assert expected[~expected.isnan()].std() > 0.02
    cost = LearnedCost(net, "float32")
    for found in (cost(spherical, RING, columns), cost(spherical, RING)):
        torch.testing.assert_close(found.double(), expected, atol=1e-5, rtol=0, equal_nan=True)
    in_bfloat16 = LearnedCost(net, "bfloat16")(spherical, RING, columns)
    torch.testing.assert_close(in_bfloat16.double(), expected, atol=2e-2, rtol=0, equal_nan=True)
    pair = patch_by_patch(net, spherical, [(0, 1)]).permute(2, 0, 1)
    plain = net(*spherical[:2].nan_to_num()).double().masked_fill(pair.isnan(), torch.nan)
    torch.testing.assert_close(plain, pair, atol=1e-5, rtol=0, equal_nan=True)


@pytest.mark.parametrize("variant", ["fast", "accurate"])
def test_gradient_reaches_every_parameter(variant):
    net = network(variant)
    torch.manual_seed(1)
    left, right = (net.extract_features(torch.randn(20, 9, 9)) for _ in range(2))
    assert left.shape == (20, {"fast": 64, "accurate": 112}[variant], 1, 1)
    net.score_pixels(net.match_features(left, right)).square().sum().backward()
    assert [
        name for name, p in net.named_parameters() if p.grad is None or p.grad.abs().max() == 0
    ] == []


def test_a_file_is_not_taken_for_the_other_variant(tmp_path):
    path = tmp_path / "a.safetensors"
    network("fast").save(path)
    assert osl.MCCNN.from_file(path).variant == "fast"
    with refused(r"a.safetensors: holds MCCNN\(variant='fast'\); expected MCCNN\(var.*acc"):
        osl.MCCNN.from_file(path, variant="accurate")
    with refused(r"a.safetensors: holds MCCNN\(variant='fast'\); expected SweepNet\."):
        osl.SweepNet.from_file(path)


def test_bad_input():
    with refused("variant = 'slow'; expected"):
        osl.MCCNN("slow")
    with refused("panorama of 20 × 8 pixels; expected at least"):
        network("fast")(*torch.zeros(2, 1, 8, 20))
