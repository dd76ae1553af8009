"""What notebook 06 shows of a network while it learns."""

import numpy as np

from course.experiments import snapshots


def test_the_stored_snapshots_are_small_and_get_better():
    assert snapshots.SNAPSHOTS.stat().st_size < 150_000
    stored = np.load(snapshots.SNAPSHOTS)
    assert tuple(stored["steps"]) == snapshots.STEPS and len(stored["wrong"]) == len(snapshots.STEPS)
    index = stored["index"]
    assert index.shape == (len(snapshots.STEPS), 40, 160) and index.dtype == np.uint8
    assert set(np.unique(index)) <= {*range(32), snapshots.UNSEEN}
    assert stored["wrong"][-1] < 0.6 * stored["wrong"][0]
