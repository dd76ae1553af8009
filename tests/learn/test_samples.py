"""Samples to train on: labels that tell the truth, patches that match or not, the loss."""

import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
import scene
import torch
from tiny import MCCNN, SWEEPNET

import omnistereo_lib as osl
from omnistereo_learn.samples.patches import PatchBatch, PatchSamples
from omnistereo_learn.samples.spheres import SphereBatch, SphereSamples, Strip


@pytest.mark.parametrize("augment", [False, True])
def test_positives_are_where_the_truth_is_and_show_the_same(data, augment):
    """Labels against the box where nothing is turned; against the pictures where it is."""
    samples = SphereSamples(replace(SWEEPNET, width=96, height=24), data)
    frame = samples.training[0]
    alike = {0.0: [], 1.0: []}
    for seed in range(12):
        batch = samples.micro_batch(frame, np.random.default_rng(seed), augment)
        assert batch.spherical_images.shape == (4, 2, 24, 96)
        for strip in batch.strips:
            counts = [(strip.label == label).sum().item() for label in (0, 1)]
            assert 0 < counts[0] <= 2 * 60 and counts[1] <= 4 * counts[0]
            pixels = torch.arange(2 * strip.start, 2 * strip.stop) % 96
            seen = batch.spherical_images[[strip.i, strip.j]][..., pixels]
            a, b = seen[0][strip.labelled], seen[1][strip.labelled]
            assert not (a.isnan() | b.isnan()).any()
            for label in alike:
                alike[label] += zip(
                    a[strip.label == label].tolist(), b[strip.label == label].tolist(), strict=True
                )
    matches, others = (np.corrcoef(np.array(alike[label]).T)[0, 1] for label in (0.0, 1.0))
    assert matches > 0.9 > 0.7 > others


@pytest.mark.parametrize(("kind", "recipe"), [(SphereSamples, SWEEPNET), (PatchSamples, MCCNN)])
def test_each_frame_is_swept_with_its_own_rig(data, tmp_path, kind, recipe):
    """Among frames of another rig, a frame gives the same samples as alone."""
    other = scene.write_set(
        tmp_path / "other",
        scene.rig(0.2, 3, width=160, height=150),
        osl.SphereGrid(96, 24, (-45, 45), 12, 0.4),
        [(0, 0, 0), (0.1, 0, 0.2)],
    )
    both, alone = kind(recipe, [data, other]), [kind(recipe, folder) for folder in (data, other)]
    frames = [samples.training[0] for samples in alone]
    for k in (0, 1, 0):
        drawn, expected = (
            samples.micro_batch(frames[k], np.random.default_rng(3), augment=True)
            for samples in (both, alone[k])
        )
        assert _text(drawn) == _text(expected)


@pytest.mark.parametrize(("kind", "recipe"), [(SphereSamples, SWEEPNET), (PatchSamples, MCCNN)])
def test_samples_are_sent_to_other_processes(data, kind, recipe):
    samples = kind(recipe, [data, "endless"])
    queue = multiprocessing.Queue()
    queue.put(samples)
    copied = queue.get(timeout=60)
    drawn, again = (
        one.micro_batch(one.validation[0], np.random.default_rng(3), augment=False)
        for one in (samples, copied)
    )
    assert _text(drawn) == _text(again)


def _text(x):
    """All numbers of a micro-batch, NaN among them."""
    if isinstance(x, list):
        return [_text(part) for part in x]
    if isinstance(x, SphereBatch | PatchBatch | Strip):
        return {name: _text(part) for name, part in vars(x).items()}
    return str(np.asarray(x).tolist())


def test_labels_are_the_rounded_truth(data):
    samples = SphereSamples(
        replace(SWEEPNET, width=96, height=24, max_positives=9999, negatives=9999), data
    )
    frame = samples.training[0]
    true = np.rint(frame.gt_index(samples.grid))
    counts = np.bincount(true.astype(int).ravel(), minlength=12)
    drawn = set()
    for seed in range(30):
        block, spheres = samples._draw_spheres(
            samples.use(frame), frame, np.random.default_rng(seed)
        )
        drawn |= set(spheres.tolist())
        batch = samples.micro_batch(frame, np.random.default_rng(seed), augment=False)
        images = samples.sweep.normalize_images(frame.images)
        torch.testing.assert_close(
            batch.spherical_images,
            samples.sweep.warp_block(images, block)[:, spheres - block.start],
            equal_nan=True,
        )
        for strip in batch.strips:
            pixels = np.arange(2 * strip.start, 2 * strip.stop) % 96
            expected = (true[:, pixels] != spheres[:, None, None])[strip.labelled.numpy()]
            np.testing.assert_array_equal(strip.label.numpy(), expected)
    # those with fewer positives are discarded
    assert drawn == set(np.flatnonzero(counts >= 4).tolist())


def test_where_nothing_is_there_are_negatives(data):
    recipe = replace(
        SWEEPNET, width=96, height=24, num_spheres=24, any_sphere=1.0, min_negatives=50
    )
    samples = SphereSamples(recipe, data)
    frame = samples.training[0]
    counts = np.bincount(np.rint(samples.use(frame)).astype(int).ravel(), minlength=24)
    drawn, matched = set(), set()
    for seed in range(80):
        rng = np.random.default_rng(seed)
        drawn |= {*samples._draw_spheres(samples.use(frame), frame, rng)[1].tolist()}
    for seed in range(8):
        _, spheres = samples._draw_spheres(samples.use(frame), frame, np.random.default_rng(seed))
        batch = samples.micro_batch(frame, np.random.default_rng(seed), augment=False)
        for strip in batch.strips:
            on = spheres[strip.labelled.nonzero()[:, 0]]
            matched |= set(on[strip.label.numpy() == 0].tolist())
            assert all(
                (strip.label.numpy()[on == n] == 1).sum() >= 50 for n in set(on.tolist()) - matched
            )
        loss, error = samples.objective(batch)
        assert loss.isfinite() and 0 <= error <= 1
    assert drawn == set(range(24))  # those with few positives as well
    assert matched <= set(np.flatnonzero(counts >= 4).tolist()) and matched


def test_the_loss_is_the_balanced_cross_entropy(data):
    torch.manual_seed(0)  # weights for which no cost is so near to 1 that float32 rounds 1 - cost
    samples = SphereSamples(SWEEPNET, data)
    network = samples.network.eval()
    batch = samples.micro_batch(samples.training[0], np.random.default_rng(0), augment=True)
    loss, error = samples.objective(batch)
    cost, label = [], torch.cat([strip.label for strip in batch.strips])
    for strip in batch.strips:  # one by one on the whole panorama
        pixels = torch.arange(2 * strip.start, 2 * strip.stop) % samples.grid.width
        left, right = batch.spherical_images[[strip.i, strip.j]].nan_to_num()
        cost.append(network(left, right)[..., pixels][strip.labelled])
    cost = torch.cat(cost).double()
    expected = -0.5 * (1 - cost[label == 0]).log().mean() - 0.5 * cost[label == 1].log().mean()
    assert loss.item() == pytest.approx(expected.item(), abs=1e-5)
    far, near = cost[label == 0] > 0.5, cost[label == 1] <= 0.5
    wrong = 0.5 * far.double().mean() + 0.5 * near.double().mean()
    assert error.item() == pytest.approx(wrong.item(), abs=1e-5)


def test_patches_are_cut_out_of_the_panorama(data):
    samples = PatchSamples(MCCNN, data)
    image = samples.images(samples.training[0], None)[1]
    warped = [samples.sweep.warp([image] * 4, n)[1] for n in (3, 7)]
    pixel = np.array([[6, 50], [0, 51], [23, 95], [5, 0]])
    for n, panorama in zip((3, 7), warped, strict=True):
        padded = np.pad(np.nan_to_num(panorama), ((4, 4), (0, 0)))
        columns = (pixel[:, 1, None] + np.arange(-4, 5)) % 96
        expected = [padded[row : row + 9][:, c] for (row, _), c in zip(pixel, columns, strict=True)]
        found = samples.patches(image.numpy(), 1, pixel, np.full(4, float(n)))
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_point_is_shown_where_its_camera_looks(data):
    """The point and the place on the swept sphere must project to the same pixel."""
    samples = PatchSamples(MCCNN, data)
    rows, columns = (
        np.random.default_rng(0).integers(size, size=200) for size in samples.grid.shape
    )
    true, swept = (np.random.default_rng(seed).uniform(0, 11, 200) for seed in (1, 2))
    for camera in range(4):
        point, valid = samples._project(camera, samples.rays[rows, columns], samples._inverse(true))
        shown = samples._apparent_direction(camera, samples.rays[rows, columns], true, swept)
        np.testing.assert_allclose(np.linalg.norm(shown, axis=-1), 1, atol=1e-12)
        uv, _ = samples._project(camera, shown, samples._inverse(swept))
        assert valid.sum() > 50
        np.testing.assert_allclose(uv[valid], point[valid], atol=1e-6)


def test_non_matches_lie_so_many_pixels_off(data):
    samples = PatchSamples(
        replace(MCCNN, width=192, height=48, num_spheres=48, negative_high_px=4.0), data
    )
    index = samples.use(samples.training[0])
    drawn = []
    for i, j in samples.pairs:
        pixel, match, other = samples.draw_rays(index, i, j, 100, np.random.default_rng(i))
        rows, columns = pixel.T
        true = index[rows, columns]
        for camera in (i, j):
            assert samples.sees(camera, rows, columns, true).all()
            assert samples.sees(camera, rows, columns, other).all()
        assert (samples.pair_shift_px(i, j, rows, columns, true, match - true) < 0.6).all()
        drawn.append(samples.pair_shift_px(i, j, rows, columns, true, other - true))
    drawn = np.concatenate(drawn)
    assert len(drawn) > 200 and 1.2 < drawn.min() < 1.7 and 3.5 < drawn.max() < 5.0


def test_what_stands_in_between_hides_a_point(data):
    samples = PatchSamples(MCCNN, data)
    index = np.full(samples.grid.shape, 1.0, np.float32)
    post = 48 + np.arange(-3, 4)  # straight ahead, on the nearest sphere
    index[:, post] = 11.0
    rows, columns, far = np.full(96, 12), np.arange(96), np.full(96, 1.0)
    hidden = samples._occluded(0, index, rows, columns, far)
    assert hidden[48] and not hidden[:36].any() and not hidden[61:].any()
    assert not samples._occluded(0, np.full_like(index, 1.0), rows, columns, far).any()


def test_half_of_the_micro_batches_are_of_half_size(data):
    recipe = replace(SWEEPNET, width=96, height=24, num_spheres=24, halve=True, spheres_per_frame=1)
    samples = SphereSamples(recipe, data)
    batches = [
        samples.micro_batch(samples.training[0], np.random.default_rng(k), augment=True)
        for k in range(60)
    ]
    shapes = [tuple(batch.spherical_images.shape[1:]) for batch in batches]
    assert set(shapes) == {(1, 24, 96), (2, 12, 48)}
    assert samples._half_size.training is samples.training
    assert samples._half_size.network is samples.network
    assert 15 < shapes.count((1, 24, 96)) < 45
    assert all(
        strip.label.min() == 0 and strip.label.max() == 1
        for batch in batches
        for strip in batch.strips[:1]
    )
