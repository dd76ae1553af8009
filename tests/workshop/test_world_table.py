"""`python -m workshop world-table`: which rays are right, which lie at an edge, F of a mesh."""

import numpy as np
import pytest

from workshop.results.world_table import f_scores, right_rays


def test_rays_are_counted_by_distance_and_at_edges():
    truth = np.full((20, 40), 1 / 20.0, np.float32)
    truth[:, 10:20] = 1 / 5.0
    truth[:2] = 0  # sky
    estimate = truth.copy()
    estimate[:, 11] *= 1.1  # wrong, next to an edge
    moving = np.zeros(truth.shape, bool)
    share = right_rays(estimate, truth, moving)
    assert share["nearer than 8 m"] == 90 and share["15 to 25 m"] == 100
    assert np.isnan(share["8 to 15 m"]) and np.isnan(share["driving cars"])
    # 8 columns by 18 rows beside the two jumps, and the other 32 columns in 2 rows below the sky;
    # one column is wrong.
    assert share["at edges"] == pytest.approx(100 * (1 - 18 / (8 * 18 + 32 * 2)))
    moving[:, 10:12] = True
    share = right_rays(estimate, truth, moving)
    assert share["driving cars"] == 50 and share["nearer than 8 m"] == 100


def test_f_is_the_harmonic_mean_of_precision_and_recall():
    true = np.stack([np.arange(100.0), np.zeros(100), np.zeros(100)], axis=1)
    found = np.concatenate([true[:50] + np.array([0, 0.15, 0]), np.full((50, 3), 9e3)])
    np.testing.assert_allclose(f_scores(found, true), [0, 50, 50])
