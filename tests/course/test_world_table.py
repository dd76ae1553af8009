"""The figures of `python -m course world-table`: which rays are right, and which lie at an edge."""

import numpy as np
import pytest

from course.experiments.world_table import right_rays


def test_rays_are_counted_by_distance_and_at_edges():
    truth = np.full((20, 40), 1 / 20.0, np.float32)
    truth[:, 10:20] = 1 / 5.0
    truth[:2] = 0  # sky
    estimate = truth.copy()
    estimate[:, 11] *= 1.1  # wrong, next to an edge
    share = right_rays(estimate, truth)
    assert share["nearer than 8 m"] == 90 and share["15 to 25 m"] == 100
    assert np.isnan(share["8 to 15 m"])
    # 8 columns by 18 rows beside the two jumps, and the other 32 columns in 2 rows below the sky; one column is wrong.
    assert share["at edges"] == pytest.approx(100 * (1 - 18 / (8 * 18 + 32 * 2)))
