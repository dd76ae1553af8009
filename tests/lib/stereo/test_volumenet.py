"""VolumeNet: every part against its definition, and what must hold for any weights."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
import scene
import torch
from scene import refused
from torch.profiler import ProfilerActivity, profile

import omnistereo_lib as osl
from omnistereo_lib import reference
from omnistereo_lib.stereo import threads
from omnistereo_lib.stereo.correlation import (
    coordinates_of,
    correlate,
    feature_coordinates,
    volume_cells,
    volume_sizes,
)
from omnistereo_lib.stereo.kernels import correlation_numba, read_out_numba
from omnistereo_lib.stereo.kernels.double_numba import add_doubled
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.volumenet import (
    VolumeNet,
    costs_of,
    double,
    local_mean,
    normalize,
    resize_logits,
)

GRID = osl.SphereGrid(96, 32, (-45, 45), 32, 0.6)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return VolumeNet().eval()


@pytest.mark.parametrize(
    ("grid", "sizes"),
    [
        ((200, 50, 64), [(160, 40, 32)]),
        ((320, 80, 64), [(160, 40, 32), (240, 64, 48)]),
        ((640, 160, 192), [(160, 40, 32), (320, 80, 48)]),
        ((1200, 300, 192), [(160, 40, 32), (320, 80, 48)]),
        ((96, 24, 16), [(160, 40, 32)]),  # finer than the grid, as the network was trained
    ],
)
def test_the_sizes_of_the_volumes(grid, sizes):
    assert volume_sizes(osl.SphereGrid(*grid[:2], num_spheres=grid[2])) == sizes


@pytest.mark.parametrize(
    ("columns", "pixels", "finer"),
    [
        (640, 800, (320, 80, 48)),
        (640, 600, (240, 64, 48)),
        (320, 800, (240, 64, 48)),
        (640, 400, (160, 40, 48)),
        (320, 100, (160, 40, 48)),
    ],
)
def test_the_finer_volume_suits_the_images(columns, pixels, finer):
    grid = osl.SphereGrid(columns, columns // 4, num_spheres=192)
    assert volume_sizes(grid, scene.rig(width=pixels, height=pixels)) == [(160, 40, 32), finer]


def test_the_correlation_and_its_gradient_are_those_of_the_definition():
    rng = torch.Generator().manual_seed(3)
    uv = [torch.rand(8, 8, 16, 2, generator=rng) * torch.tensor([18.0, 12.0 + k]) for k in range(4)]
    for at in uv:
        at[torch.rand(8, 8, 16, generator=rng) < 0.4] = torch.nan
    uv[0][0, 0, 0] = torch.tensor([18.0, 12.0])  # the last pixel of a map
    maps = [torch.randn(32, 13 + k, 19, generator=rng).requires_grad_() for k in range(4)]
    upstream = torch.randn(9, 8, 8, 16, generator=rng)
    loops = correlate(maps, uv)
    by_loops = torch.autograd.grad((loops * upstream).sum(), maps)
    exact = [one.detach().double().requires_grad_() for one in maps]
    expected = reference.correlate(exact, [at.double() for at in uv], groups=8)
    assert torch.allclose(loops.double(), expected, atol=1e-5)
    by_definition = torch.autograd.grad((expected * upstream).sum(), exact)
    for a, b in zip(by_loops, by_definition, strict=True):
        assert torch.allclose(a.double(), b, atol=1e-5)
    nowhere = ([one.to("meta") for one in arrays] for arrays in (maps, uv))
    assert correlate(*nowhere).shape == loops.shape


def test_cells_land_on_the_features_of_their_points():
    rig = scene.rig(cameras=3).recentered()
    grid = osl.SphereGrid(320, 96, (-45, 45), 64, 0.6)
    size = volume_sizes(grid)[0]
    coordinates = feature_coordinates(rig, grid, size)
    assert coordinates[0].shape == (*size, 2) == (160, 48, 32, 2)
    rays = replace(grid, width=160, height=48).rays()
    for column, row, sphere in ((0, 0, 0), (57, 15, 19), (140, 45, 31)):
        # Sphere m of the volume lies between the spheres 2 m and 2 m + 1 of the grid.
        depth = 2 / (grid.inverse_depths()[2 * sphere] + grid.inverse_depths()[2 * sphere + 1])
        for camera, pose, uv in zip(rig.cameras, rig.T_rig_cam, coordinates, strict=True):
            pixel, visible = camera.project(pose.inverse() @ (rays[row, column] * depth))
            found = uv[column, row, sphere].numpy()
            assert np.isfinite(found).all() == visible
            assert not visible or np.abs(2 * found - pixel).max() < 2e-3


def test_points_land_where_the_camera_projects_them_to_the_bit():
    rng = np.random.default_rng(3)
    odd = [0.0, -0.0, 1, -1, 1e-45, 1e-30, 1e30, np.inf, -np.inf, np.nan]
    points = torch.from_numpy(
        np.concatenate([rng.choice(odd, (3, 5000)), rng.normal(size=(3, 5000))], 1)
    ).float()
    camera = scene.rig(cameras=2).cameras[0]
    holes = replace(camera, mask=rng.random(camera.image_size[::-1]) > 0.3)
    for one in (camera, holes):
        uv, visible = one.project(points.T)
        expected = torch.where(visible[:, None], uv / 2, torch.nan)
        found = correlation_numba.project(one, points)
        assert visible.sum() > 1000
        assert torch.equal(found.view(torch.int32), expected.view(torch.int32))


def test_coordinates_computed_as_they_are_read_are_those_of_the_tables():
    rig = scene.rig(cameras=3).recentered()
    grid = osl.SphereGrid(64, 16, num_spheres=16, min_depth=0.6)
    maps = [torch.randn(32, camera.image_size[1] // 2, 90) for camera in rig.cameras]
    read = coordinates_of(rig, *volume_cells(grid, (40, 16, 8)))
    tables = feature_coordinates(rig, grid, (40, 16, 8))
    assert torch.allclose(correlate(maps, read), correlate(maps, tables), atol=1e-4)


def test_the_volume_has_no_seam(network):
    volume = torch.from_numpy(np.random.default_rng(2).normal(size=(1, 9, 48, 16, 16))).float()
    with torch.no_grad():
        # the deepest level has every eighth column
        logits, rolled = network(volume), network(volume.roll(16, 2))
    assert torch.allclose(logits.roll(16, 1), rolled, atol=1e-4)


def test_what_runs_in_one_pass_is_what_the_layers_say(network):
    """Where a gradient is asked for, each layer takes passes of its own."""
    rng = torch.Generator().manual_seed(1)
    image, visible = (torch.randn(70, 62, generator=rng), torch.rand(70, 62, generator=rng) > 0.3)
    volume = torch.randn(1, 9, 16, 8, 8, generator=rng)
    by_layers = network.features(image, visible), network(volume)
    assert all(one.requires_grad for one in by_layers)
    with torch.no_grad():
        fused = network.features(image, visible), network(volume)
    for a, b in zip(fused, by_layers, strict=True):
        assert torch.allclose(a, b, atol=1e-5)


@pytest.mark.parametrize("layout", [torch.channels_last_3d, torch.contiguous_format])
def test_a_step_up_in_one_pass_has_the_bits_of_its_steps(layout):
    """In bfloat16: doubling rounds, and the sum rounds again. Without oneDNN the coarser level has
    its channels first.
    """
    rng = torch.Generator().manual_seed(3)
    x, level = (
        torch.randn(2, 3, *size, generator=rng).bfloat16().contiguous(memory_format=layout)
        for size, layout in (((5, 3, 4), layout), ((10, 6, 8), torch.channels_last_3d))
    )
    expected = level + double(x)
    assert torch.equal(add_doubled(level, x), expected)
    assert torch.equal(level, expected)  # in place


def test_costs_by_loops_are_the_softmax_of_resized_logits():
    rng = torch.Generator().manual_seed(2)
    logits = [5 * torch.randn(1, *size, generator=rng) for size in ((16, 8, 8), (24, 16, 12))]
    hidden = torch.rand(32, 96, generator=rng) < 0.1
    columns = torch.arange(96)
    mean = sum(resize_logits(one, columns, GRID)[0] for one in logits).transpose(0, 1)
    expected = (1 - mean.double().softmax(-1)).masked_fill(hidden[..., None], torch.nan)
    loops = costs_of(logits, hidden, GRID)[:].double()
    assert torch.allclose(loops, expected, atol=1e-6, equal_nan=True)


def test_resized_logits_are_interpolated_around_the_seam():
    theta = 2 * np.pi * (torch.arange(48) + 0.5) / 48
    logits = (
        torch.cos(theta)[:, None, None]
        + torch.linspace(0, 1, 16)[:, None]
        + torch.linspace(0, 2, 16)
    )[None]
    full = resize_logits(logits, torch.arange(96), GRID)
    assert full.shape == (1, 96, 32, 32)
    expected = torch.cos(2 * np.pi * (torch.arange(96) + 0.5) / 96)
    assert (full[0, :, 8, 8] - full[0, :, 8, 8].mean() - expected).abs().max() < 0.005
    assert torch.allclose(full[0, 3].diff(dim=0)[1:-1], torch.full((29, 32), 1 / 30), atol=1e-6)
    assert torch.allclose(
        resize_logits(logits, torch.tensor([95, 0]), GRID), full[:, [95, 0]], atol=1e-6
    )


def test_the_read_out_is_the_mean_around_the_best_sphere():
    p = torch.zeros(1, 3, 10)
    p[0, 0, 3], p[0, 0, 4], p[0, 0, 9] = 0.5, 0.25, 0.25  # a second surface does not pull it away
    p[0, 1, 0], p[0, 1, 1] = 0.75, 0.25  # at the far end
    index, confidence = local_mean(torch.where(torch.arange(3)[:, None] == 2, torch.nan, 1 - p))
    assert torch.allclose(index[0, :2], torch.tensor([3 + 1 / 3, 0.25]))
    assert torch.allclose(confidence[0, :2], torch.tensor([0.75, 1.0]))
    assert index[0, 2].isnan() and confidence[0, 2].isnan()


@pytest.mark.parametrize("num_spheres", [16, 100])
def test_the_read_out_by_brute_force(num_spheres):
    """Sphere n fills n ± 0.5; of the probability of each, the part inside of the window counts."""
    rng = np.random.default_rng(0)
    p = rng.random((5, 1, num_spheres)) ** 8
    p /= p.sum(-1, keepdims=True)
    n, radius = np.arange(num_spheres), max(1, num_spheres / 32) + 0.5
    expected = []
    for ray in p[:, 0]:
        index = ray.argmax()
        for _ in range(3):
            inside = np.minimum(n + 0.5, index + radius) - np.maximum(n - 0.5, index - radius)
            mass = ray * inside.clip(0)
            index = (mass * n).sum() / mass.sum()
        expected.append([index, mass.sum()])
    ours = torch.cat(local_mean(1 - torch.from_numpy(p)), 1)
    np.testing.assert_allclose(ours, expected, rtol=1e-5)


def test_the_mean_reaches_into_the_cells_beside_the_best_one():
    """A wall between two of the 48 cells: the mean must not stay in one."""
    cells = torch.linspace(0.0, 1.0, 9)  # how far the wall is from the first cell to the next
    logits = torch.full((9, 1, 48), -20.0)
    logits[:, 0, 20], logits[:, 0, 21] = torch.log(1 - cells + 1e-6), torch.log(cells + 1e-6)
    fine = torch.nn.functional.interpolate(logits, 192, mode="linear", align_corners=False)
    index, _ = local_mean(1 - fine.softmax(-1))
    true = (20 + cells + 0.5) * 4 - 0.5
    assert (index[:, 0] - true).abs().max() < 1
    assert index[:, 0].diff().min() > 0.15  # the mean over ±2 spheres stands still: 0.09 and less


def test_the_most_probable_sphere_may_be_between_two_cells():
    """Logits that are highest between two of eight cells, 12 spheres each."""
    grid = osl.SphereGrid(8, 8, num_spheres=96)
    peak = torch.linspace(3, 4, 5)
    logits = -((torch.arange(8) - peak[:, None]) ** 2)
    full = resize_logits(logits[:, None, None].expand(5, 8, 8, 8), torch.arange(1), grid)[:, 0, 0]
    # by linear interpolation: 5.5
    assert (full.argmax(-1) - ((peak + 0.5) * 12 - 0.5)).abs().max() < 2


def test_images_are_normalized_over_their_circle():
    image, visible = torch.arange(12.0).view(3, 4), torch.tensor([[True] * 3 + [False]] * 3)
    ours = normalize(image, visible)
    assert abs(ours[visible].mean()) < 1e-6
    assert abs(ours[visible].std() - 1) < 1e-6
    assert (ours[~visible] == 0).all()
    assert (normalize(torch.ones(3, 4), visible) == 0).all()


@pytest.mark.parametrize("cameras", [2, 3, 5])
def test_any_rig_and_any_grid(network, cameras):
    """Sizes that are no multiples of 16, and rays that no two cameras share."""
    rig = scene.rig(cameras=cameras, max_fov_deg=200.0, width=120, height=112)
    grid = osl.SphereGrid(50, 22, (-80, 80), 18, 0.6)
    sweep = SphereSweep(rig, grid)
    volume = cost_volume(sweep, scene.images(rig, finest=0.5), network)
    assert volume.shape == (22, 50, 18)
    known = volume.isfinite()
    assert torch.equal(known.any(-1), known.all(-1))
    assert torch.allclose((1 - volume)[known.all(-1)].sum(-1), torch.tensor(1.0), atol=1e-4)
    shared = np.sum([sweep.project_sphere(c, n)[1] for c in range(cameras) for n in (0,)], 0) >= 2
    assert (known.all(-1).numpy() == shared).mean() > 0.9 and (cameras == 5 or not known.all())


def test_two_frames_of_one_sweep(network):
    """What is kept from frame to frame does not depend on the frame."""
    rig = scene.rig(width=120, height=112)
    sweep, images = SphereSweep(rig, GRID), scene.images(rig, finest=0.5)
    first = cost_volume(sweep, images, network)
    cost_volume(sweep, images[::-1], network)
    assert torch.equal(cost_volume(sweep, images, network), first)
    in_color = cost_volume(sweep, [np.stack([i] * 3, -1) for i in images], network)
    assert torch.allclose(in_color, first, atol=1e-3)


@torch.no_grad()
def test_a_correlation_that_is_asked_for_is_in_float32():
    """A student's own network takes it, whatever the precision of the features."""
    bundled, rig, size = VolumeNet.pretrained(), scene.rig(width=60, height=56), (32, 16, 8)
    bundled.precision = "bfloat16"
    frame, sweep = osl.Frame.of(rig, scene.images(rig, finest=0.5)), SphereSweep(rig, GRID)
    alone = bundled.correlation_at(sweep, frame, size, bundled.features_of(sweep, frame))
    images, seen = torch.rand(2, 56, 60), torch.ones(2, 56, 60, dtype=torch.bool)
    coordinates = feature_coordinates(rig, GRID, size)[:2]
    with torch.autocast("cpu", torch.bfloat16):
        within = bundled.correlation(images, seen, coordinates)
    assert alone.dtype == within.dtype == torch.float32


def test_bfloat16_is_close(monkeypatch):
    # Smaller than usual: most processors emulate bfloat16, slowly.
    monkeypatch.setattr(
        "omnistereo_lib.stereo.volumenet.volume_sizes", lambda grid, rig: [(48, 16, 16)]
    )
    # untrained, all spheres are as likely
    shipped, rig = VolumeNet.pretrained(), scene.rig(width=120, height=112)
    images, sweep = scene.images(rig, finest=0.5), SphereSweep(rig, GRID)
    volumes = []
    for shipped.precision in ("bfloat16", "float32"):
        volumes.append(cost_volume(sweep, images, shipped))
    assert 0 < (volumes[0] - volumes[1]).abs().max() < 0.02


def test_one_frame_in_float32_takes_the_fast_kernels(network):
    """With the spheres first, PyTorch would take kernels 4 to 14 times as slow without a word."""
    volume, threads = torch.zeros(1, 9, 160, 40, 32), torch.get_num_threads()
    torch.set_num_threads(2)  # with one, PyTorch always takes the slow ones
    with torch.no_grad(), profile(activities=[ProfilerActivity.CPU], record_shapes=True) as trace:
        network(volume)
    torch.set_num_threads(threads)
    shapes = {"slow_conv3d": [], "_convolution_pointwise": []}
    for event in trace.events():
        if (name := event.name.partition("::")[2]) in shapes:
            shapes[name].append(event.input_shapes[0])
    assert len(shapes["_convolution_pointwise"]) >= 8
    assert all(shape[2] <= 42 for shape in shapes["slow_conv3d"]), (
        "the two small levels alone may be slow"
    )


def test_weights_travel_in_a_file(network, tmp_path):
    network.save(tmp_path / "volumenet.safetensors")
    rig = scene.rig(width=120, height=112)
    images = scene.images(rig, finest=0.5)
    method = Method.parse("volumenet")
    assert method.name == "volumenet" and method.label == "VolumeNet"
    index, confidence = method.read_out(
        cost_volume(SphereSweep(rig, GRID), images, method.load_cost(tmp_path))
    )
    expected = local_mean(cost_volume(SphereSweep(rig, GRID), images, network))
    assert torch.equal(index, expected[0]) and torch.equal(confidence, expected[1])


def test_depth_is_read_from_a_few_rows_at_a_time(network, monkeypatch):
    rig = scene.rig(width=120, height=112)
    sweep, frame = SphereSweep(rig, GRID), osl.Frame.of(rig, scene.images(rig, finest=0.5))
    read, compute = [], read_out_numba.Costs.__getitem__

    def rows_of(volume, rows):
        read.append(range(*rows.indices(volume.shape[0])))
        return compute(volume, rows)

    monkeypatch.setattr(read_out_numba.Costs, "__getitem__", rows_of)
    monkeypatch.setattr(threads, "PART", 5 * GRID.width * GRID.num_spheres)
    monkeypatch.setattr(Method, "cost_of", lambda *_: network)
    found = sweep_depth(sweep, frame, "volumenet")
    assert max(map(len, read)) == 5 and {*chain(*read)} == {*range(GRID.height)}
    index, confidence = local_mean(cost_volume(sweep, frame, network))
    np.testing.assert_array_equal(found.index, index)
    np.testing.assert_array_equal(found.confidence, confidence)


def test_images_are_checked(network):
    rig = scene.rig(width=120, height=112)
    *images, last = scene.images(rig, finest=0.5)
    with refused("image 4 has NaN"):
        cost_volume(SphereSweep(rig, GRID), [*images, np.where(last > 40, np.nan, last)], network)


def test_progress_goes_over_the_whole_work_and_names_its_parts(network):
    """When a part is named, no more than the parts before it are done."""
    rig, seen, done = scene.rig(width=100, height=96), [], []
    hooks = [
        network.features.register_forward_hook(lambda *_: done.append("camera")),
        network.up[0].register_forward_hook(lambda *_: done.append("U-net")),
    ]
    progress = lambda *call: seen.append((*call, len(done)))  # noqa: E731
    cost_volume(SphereSweep(rig, GRID), scene.images(rig, finest=0.25), network, progress=progress)
    for hook in hooks:
        hook.remove()
    cameras = [f"camera {k} of 4" for k in (1, 2, 3, 4)]
    names = [*cameras, "tables", "correlation", "U-net", ""]
    before = [0, 1, 2, 3, 4, 4, 4, 5]
    assert seen == [(k, 7, *named) for k, named in enumerate(zip(names, before, strict=True))]
