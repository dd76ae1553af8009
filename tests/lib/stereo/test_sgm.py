"""SGM against its definition in float64, and beyond it: laps, threads, memory."""

from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from omnistereo_lib import reference
from omnistereo_lib.reference import MAX_LAPS
from omnistereo_lib.stereo.kernels.sgm_numba import _tiles
from omnistereo_lib.stereo.sgm import sgm


def noise(shape, seed=0, unknown=0.0):
    rng = np.random.default_rng(seed)
    volume = rng.random(shape, dtype=np.float32)
    volume[rng.random(shape) < unknown] = np.nan
    return volume


def in_float64(volume, p1, p2, paths=8, wrap=True):
    return reference.sgm(torch.from_numpy(np.asarray(volume)).double(), p1, p2, paths, wrap)


@given(
    shape=st.tuples(st.integers(1, 7), st.integers(1, 20), st.integers(2, 40)),
    seed=st.integers(0, 2**32 - 1),
    unknown=st.sampled_from([0.0, 0.2, 0.6]),
    paths=st.sampled_from([4, 8]),
    wrap=st.booleans(),
    p1=st.sampled_from([0.0, 0.1]),
    p2=st.floats(0.1, 20),
)
@settings(max_examples=60)
def test_agrees_with_the_definition(shape, seed, unknown, paths, wrap, p1, p2):
    volume = noise(shape, seed, unknown)
    volume[-1, -1] = np.nan if unknown else volume[-1, -1]  # a whole ray too
    expected = in_float64(volume, p1, p2, paths, wrap)
    found = sgm(volume, p1, p2, paths, wrap)
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-5)


def test_agrees_with_the_definition_at_teaching_width():
    volume = noise((80, 320, 16), unknown=0.1)
    for wrap in (True, False):
        np.testing.assert_allclose(
            sgm(volume, wrap=wrap), in_float64(volume, 0.1, 12.0, 8, wrap), atol=1e-5
        )


def test_a_row_that_alternates_for_ever_stops_after_the_last_lap():
    volume = noise((1, 6, 6), seed=141, unknown=0.1)
    with mock.patch.object(reference, "MAX_LAPS", MAX_LAPS - 1):
        lap_before = in_float64(volume, 0.1, 1.0, 4)
    assert not torch.allclose(
        lap_before, in_float64(volume, 0.1, 1.0, 4), rtol=0, atol=1e-3, equal_nan=True
    )
    np.testing.assert_allclose(sgm(volume, 0.1, 1.0), in_float64(volume, 0.1, 1.0), atol=1e-5)


def test_a_ray_with_nothing_to_compare_passes_messages_on():
    """Rays of constant cost, without known cells, or with one, are the same to all others."""
    volume = noise((6, 9, 12))
    hole = np.s_[2:4, 3:6]
    volume[hole] = 0.7
    constant = sgm(volume).numpy()
    for known in (0, 1):
        volume[hole] = np.nan
        volume[hole][..., 5 : 5 + known] = 0.2
        smooth = sgm(volume).numpy()
        np.testing.assert_array_equal(np.isnan(smooth), np.isnan(volume))
        volume[hole] = constant[hole] = smooth[hole] = 0.0
        np.testing.assert_allclose(smooth, constant, atol=1e-5)


@pytest.mark.parametrize(("gap", "message"), [(0.1, 1.0), (0.001, MAX_LAPS * 0.001)])
@pytest.mark.parametrize("sgm", [sgm, in_float64])
def test_one_opinion_comes_round_lap_by_lap(sgm, gap, message):
    """Without texture one pixel's message adds up to P2 over P2 / gap laps, or all laps."""
    volume = np.full((1, 5, 6), 0.5, np.float32)
    volume[0, 0] += gap * (np.arange(6) != 2)
    smooth = sgm(volume, 1.0, 1.0, 4)
    vertical = 2 * volume
    # 0 ends a leftward lap
    to_the_right, to_the_left = message, min(1.0, message - gap if message < 1 else message)
    expected = vertical + 1.0 + (to_the_right + to_the_left) * (np.arange(6) != 2)
    np.testing.assert_allclose(smooth[0, 1:], expected[0, 1:], atol=1e-5)


def test_results_do_not_depend_on_threads_or_repetition():
    volume = noise((43, 300, 19), unknown=0.1)
    threads = torch.get_num_threads()
    results = []
    try:
        for count in (1, 2, 5, threads, threads):
            torch.set_num_threads(count)
            results.append(sgm(volume).numpy())
    finally:
        torch.set_num_threads(threads)
    for result in results[1:]:
        np.testing.assert_array_equal(result, results[0])


def test_several_threads_may_call_at_once():
    volume = noise((8, 64, 32))
    expected = sgm(volume)
    with ThreadPoolExecutor(4) as pool:
        assert all(torch.equal(result, expected) for result in pool.map(sgm, [volume] * 40))


def test_tiles_visit_every_cell_once_and_never_meet():
    """Also the scanlines' slots: no two tiles of one round share one."""
    for H, W in [(1, 1), (7, 2), (9, 3), (300, 1200), (31, 257), (64, 513)]:
        visits = {False: np.zeros((H, W), int), True: np.zeros((H, W), int)}
        for tiles in _tiles(H, W):
            owner = {}
            for number, (up, top, bottom, first, last, slope) in enumerate(tiles):
                for j in range(bottom - top):
                    y = bottom - 1 - j if up else top + j
                    step = H - 1 - y if up else y
                    columns = np.arange(first + slope * j, last - slope * j) % W
                    np.add.at(visits[up][y], columns, 1)
                    for x in columns:
                        slots = [
                            ("S", y, x),
                            (up, 0, x),
                            (up, 1, (x - step) % W),
                            (up, 2, (x + step) % W),
                        ]
                        assert all(owner.setdefault(slot, number) == number for slot in slots)
        assert (visits[False] == 1).all()
        assert (visits[True] == 1).all()
