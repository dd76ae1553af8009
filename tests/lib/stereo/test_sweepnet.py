"""SweepNet against Table I in plain float64 torch, `LearnedCost` against both, and files."""

import json
import resource
import struct

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from scene import refused
from torch.nn.functional import conv2d, conv_transpose2d, linear, pad

from omnistereo_lib.stereo.learned import Features, LearnedCost, choose_precision
from omnistereo_lib.stereo.sweepnet import SweepNet
from omnistereo_lib.stereo.weights import _checksum, load_tensors, save_tensors

RING = [(0, 1), (1, 2), (2, 3), (3, 0)]


def network(**config):
    torch.manual_seed(0)
    net = SweepNet(**config).eval()
    for layer in net.layers.values():
        if layer.bias is not None:  # a zero bias would hide where it is added
            torch.nn.init.normal_(layer.bias, std=0.1)
    torch.nn.init.normal_(net.layers["fc5"].weight, std=0.02)  # costs from 0.28 to 0.97
    return net


def images(cameras=4, B=2, H=12, W=96, seed=0):
    """Warped images such that every camera sees 5/8 of the columns, and not all of their pixels."""
    rng = np.random.default_rng(seed)
    picture = rng.normal(size=(cameras, B, H, W)).astype(np.float32)
    columns = [((W * (2 * k - 2) // 8 - 5) % W, 5 * W // 8) for k in range(cameras)]
    for k, (start, width) in enumerate(columns):
        picture[k, :, :, (start + np.arange(width, W)) % W] = np.nan
    picture[rng.random(picture.shape) < 0.05] = np.nan
    return torch.from_numpy(picture), columns


def dense(net, spherical, pairs, double=True):
    """Table I, every layer on the whole panorama of every pair; wrap: circular columns."""
    weights = {
        name.removeprefix("layers."): w.double() if double else w
        for name, w in net.state_dict().items()
    }

    def around(x, columns, wrap=net.wrap):
        return pad(x, (*columns, 0, 0), mode="circular") if wrap else pad(x, columns)

    def conv(name, x):
        return conv2d(
            around(x, (1, 1)), weights[f"{name}.weight"], weights[f"{name}.bias"], padding=(1, 0)
        )

    def tower(image):
        x = around(image[:, None].nan_to_num(), (2, 2), wrap=True)
        x = conv2d(
            x, weights["conv1.weight"], weights["conv1.bias"], stride=2, padding=(2, 0)
        ).relu()
        for k in range(2, 18, 2):
            x = (x + conv(f"conv{k + 1}", conv(f"conv{k}", x).relu())).relu()
        return conv("conv18", x).relu()

    def match(a, b):
        x = conv("conv19", torch.cat([a, b], 1)).relu()
        x = conv_transpose2d(
            around(x, (0, 1)), weights["deconv1.weight"], weights["deconv1.bias"], 2, 1, 1
        )
        x = conv("conv20", x[..., : 2 * a.shape[-1]].relu()).relu().permute(0, 2, 3, 1)
        for k in range(1, 5):
            x = linear(x, weights[f"fc{k}.weight"], weights[f"fc{k}.bias"]).relu()
        return linear(x, weights["fc5.weight"], weights["fc5.bias"])[..., 0].sigmoid()

    costs = []
    for i, j in pairs:
        a, b = (spherical[k].double() if double else spherical[k] for k in (i, j))
        costs.append(match(tower(a), tower(b)).masked_fill((a + b).isnan(), torch.nan))
    return torch.stack(costs).nanmean(0).permute(1, 2, 0)


def test_layers_and_parameters_are_those_of_table_one():
    net = SweepNet()
    assert sum(p.numel() for p in net.parameters()) == 757_729
    shapes = {name: tuple(layer.weight.shape) for name, layer in net.layers.items()}
    expected = {"conv1": (32, 1, 5, 5), **{f"conv{k}": (32, 32, 3, 3) for k in range(2, 19)}}
    expected |= {"conv19": (128, 64, 3, 3), "deconv1": (128, 128, 3, 3), "conv20": (128, 128, 3, 3)}
    expected |= {"fc1": (256, 128), **{f"fc{k}": (256, 256) for k in (2, 3, 4)}, "fc5": (1, 256)}
    assert shapes == expected
    # W/2 × H/2 × 32 for each camera, W × H × 128 and W × H for a pair
    features = net.extract_features(torch.zeros(3, 8, 20 + 4))
    assert features.shape == (3, 32, 4, 10)
    assert net.match_features(features, features).shape == (3, 8, 20, 128)
    assert net(*torch.zeros(2, 3, 8, 20)).shape == (3, 8, 20)


def test_a_case_done_by_hand():
    """One weight 1 in every layer: a path of additions through the network that a pencil can
    follow.

    conv1 takes the pixel at the middle of its window. Each of the 8 blocks adds what its two layers
    pass on, so it
    doubles: 2⁸. conv18 passes on. conv19 adds left and right, the transposed convolution copies
    each half-size pixel (y, x) to (2y, 2x) alone, conv20 takes the pixel to its left, fc1 … fc4
    pass on, fc5 multiplies by 2⁻⁹ and subtracts 1."""
    net = network()
    for layer in net.layers.values():
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    with torch.no_grad():
        for name, layer in net.layers.items():
            if name.startswith("fc"):
                layer.weight[0, 0] = 1
            else:
                layer.weight[0, 0, layer.weight.shape[2] // 2, layer.weight.shape[3] // 2] = 1
        net.layers["conv19"].weight[0, 32, 1, 1] = 1
        net.layers["conv20"].weight[0, 0, 1, 1] = 0
        net.layers["conv20"].weight[0, 0, 1, 0] = 1
        net.layers["fc5"].weight[0, 0] = 2.0**-9
        net.layers["fc5"].bias[0] = -1
    left, right = torch.arange(24.0).reshape(4, 6), torch.full((4, 6), 3.0)
    expected = torch.full((4, 6), -1.0)
    expected[::2, 1::2] = (left[::2, ::2] + right[::2, ::2]) / 2 - 1
    torch.testing.assert_close(net(left[None], right[None])[0], expected.sigmoid())


@pytest.mark.parametrize("wrap", [True, False])
@pytest.mark.parametrize(
    "pairs", [RING, [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]], ids=["ring", "all"]
)
def test_the_network_and_its_fast_evaluation_equal_table_one(wrap, pairs):
    """`forward` in float64 to rounding; `LearnedCost` within its precision's tolerance."""
    net, (spherical, columns) = network(wrap=wrap), images()
    expected = dense(net, spherical, pairs)
    assert expected[~expected.isnan()].std() > 0.02
    for cost in (
        LearnedCost(net, "float32")(spherical, pairs, columns),
        LearnedCost(net, "float32")(spherical, pairs),
    ):
        torch.testing.assert_close(cost.double(), expected, atol=1e-5, rtol=0, equal_nan=True)
    in_bfloat16 = LearnedCost(net, "bfloat16")(spherical, pairs, columns)
    torch.testing.assert_close(in_bfloat16.double(), expected, atol=2e-2, rtol=0, equal_nan=True)
    left, right = (spherical[[pair[k] for pair in pairs]].double() for k in (0, 1))
    maps = net.double()(left.nan_to_num().flatten(0, 1), right.nan_to_num().flatten(0, 1)).view_as(
        left
    )
    plain = maps.masked_fill((left + right).isnan(), torch.nan).nanmean(0).permute(1, 2, 0)
    torch.testing.assert_close(plain, expected, atol=1e-12, rtol=0, equal_nan=True)


def test_the_crop_is_exact_to_rounding():
    """In float64 no error but that of a halo too narrow could be left."""
    net, (spherical, columns) = network().double(), images()
    spherical = spherical.double()
    features = [
        net.extract_columns(image, span) for image, span in zip(spherical, columns, strict=True)
    ]
    for i, j in RING:
        everywhere = net(spherical[i].nan_to_num(), spherical[j].nan_to_num())
        for start, stop in net.shared_strips(columns[i], columns[j], 96):
            cropped = net.score_pixels(
                net.match_columns(features[i], features[j], start, stop)
            ).sigmoid()
            strip = torch.arange(2 * start, 2 * stop) % 96
            seen = ~(spherical[i] + spherical[j])[..., strip].isnan().all(
                1, keepdim=True
            ).expand_as(cropped)
            assert (cropped - everywhere[..., strip])[seen].abs().max() < 1e-12


def test_a_panorama_may_be_narrower_than_what_a_pixel_depends_on():
    net, (spherical, columns) = network(), images(W=24)
    expected = dense(net, spherical, RING)
    cost = LearnedCost(net, "float32")(spherical, RING, columns)
    torch.testing.assert_close(cost.double(), expected, atol=1e-5, rtol=0, equal_nan=True)
    pair = spherical[:2].nan_to_num()
    torch.testing.assert_close(
        net(*pair).double(), dense(net, pair, [(0, 1)]).permute(2, 0, 1), atol=1e-5, rtol=0
    )


def test_fused_batch_norms_compute_the_same():
    net, pair = network(batch_norm=True), images()[0][:2].nan_to_num()
    for norm in net.norms.values():
        for tensor, low, high in ((norm.running_mean, -0.5, 0.5), (norm.running_var, 0.5, 2.0)):
            torch.nn.init.uniform_(tensor, low, high)
        torch.nn.init.uniform_(norm.weight, 0.5, 1.5)
        torch.nn.init.normal_(norm.bias, std=0.2)
    plain = net.fuse_batch_norm()
    assert plain.config == {"batch_norm": False, "wrap": True}
    assert sum(p.numel() for p in plain.parameters()) == 757_729
    torch.testing.assert_close(plain(*pair), net(*pair), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("batch_norm", [True, False])
def test_gradient_reaches_every_parameter(batch_norm):
    net = network(batch_norm=batch_norm).train()
    net(*images()[0][:2].nan_to_num()).square().sum().backward()
    assert [
        name for name, p in net.named_parameters() if p.grad is None or p.grad.abs().max() == 0
    ] == []


def test_features_keep_their_order_in_memory():
    """The gradient in float32 on a CPU is several times slower where channels come last."""
    maps = torch.zeros(2, 32, 6, 48)
    for layout in (torch.contiguous_format, torch.channels_last):
        columns = Features(maps.contiguous(memory_format=layout)[..., 2:-2], 0, 44).wrapped_columns(
            40, 60
        )
        assert columns.is_contiguous(memory_format=layout)


@pytest.mark.parametrize("size", [(13, 96), (12, 95)])
def test_odd_panoramas_are_refused(size):
    for call in (lambda x: network()(*x), lambda x: LearnedCost(network())(x, [(0, 1)])):
        with refused(f"panorama of {size[1]} × {size[0]} pixels; .* must be even"):
            call(torch.zeros(2, 1, *size))


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ({"avx512_f": True}, "float32"),
        ({"avx512_bf16": True}, "bfloat16"),
        ({"amx_bf16": True}, "bfloat16"),
    ],
)
def test_bfloat16_is_chosen_where_the_processor_says_that_it_has_it(monkeypatch, flags, expected):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: flags)
    assert choose_precision("auto", "cpu") == expected
    for asked in ("bfloat16", "float32"):
        assert choose_precision(asked, "cpu") == asked
    with refused("precision = 'float16'; expected"):
        LearnedCost(network(), "float16")


def test_weights_come_back_from_a_file_with_equal_bytes(tmp_path):
    net, pair, path = network(wrap=False), images()[0][:2].nan_to_num(), tmp_path / "a.safetensors"
    contents = set()
    for _ in range(8):  # the safetensors library orders the header at random
        net.save(path, step=7)
        contents.add(path.read_bytes())
    assert len(contents) == 1
    again = SweepNet.from_file(path)
    assert again.config == net.config
    assert not again.training
    assert torch.equal(again(*pair), net(*pair))
    assert load_tensors(path)[1]["step"] == 7
    assert load_file(path).keys() == net.state_dict().keys()  # the original library reads it


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_weights_that_are_not_finite_are_neither_written_nor_read(value, tmp_path):
    net = network()
    with torch.no_grad():
        net.layers["fc2"].bias[3] = value
    with refused(r"a.safetensors: layers.fc2.bias is NaN or infinite; expected"):
        net.save(tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())
    tensors = net.state_dict()
    header = {
        "about": json.dumps({"architecture": "SweepNet", "config": net.config}),
        "sha256": _checksum(tensors),
    }
    save_file(tensors, tmp_path / "b.safetensors", header)
    with refused(r"b.safetensors: layers.fc2.bias is NaN or infinite; expected"):
        SweepNet.from_file(tmp_path / "b.safetensors")


def test_bad_files_of_weights(tmp_path):
    path = tmp_path / "a.safetensors"
    with refused(r"a.safetensors cannot be read: No such file"):
        SweepNet.from_file(path)
    network().save(path)
    content = path.read_bytes()
    for keep in (0, 4, 1000, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:keep])
        with refused(r"a.safetensors is not a complete safetensors file"):
            SweepNet.from_file(path)
    path.write_bytes(content[:-5] + bytes([content[-5] ^ 1]) + content[-4:])
    with refused("has changed since it was written"):
        SweepNet.from_file(path)
    header = json.dumps({}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    with refused("was not written by this library"):
        SweepNet.from_file(path)
    save_tensors(path, {}, {"architecture": "MCCNN", "config": {}})
    with refused(r"a.safetensors: holds MCCNN; expected SweepNet"):
        SweepNet.from_file(path)
    save_tensors(path, {"fc1.weight": torch.zeros(2)}, {"architecture": "SweepNet", "config": {}})
    with refused("does not fit SweepNet"):
        SweepNet.from_file(path)


def test_a_full_disk_leaves_the_old_weights(tmp_path):
    """A limit on the size of files stands for the disk: refused the same way, halfway."""
    path = tmp_path / "a.safetensors"
    save_tensors(path, {"x": torch.zeros(2)}, {})
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, hard))
    try:
        with refused(r"a.safetensors cannot be written: File too large"):
            network().save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [file.name for file in tmp_path.iterdir()] == ["a.safetensors"]
    assert load_tensors(path)[0]["x"].tolist() == [0, 0]
