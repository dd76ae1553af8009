"""The share of right rays by distance: a large rig sees far things, a small one near things."""

import pytest

from course.experiments import rig_sizes


def test_a_large_rig_sees_far_things_and_a_small_one_near_things(monkeypatch):
    monkeypatch.setattr(rig_sizes, "KINDS", rig_sizes.KINDS[:1])
    monkeypatch.setattr(rig_sizes, "WORLDS", 1)
    (near, of_small), (far, of_large) = (rig_sizes.shares(size, "zncc") for size in (0.2, 4.0))
    assert far == pytest.approx(20 * near, rel=0.05)
    assert of_large[:3] == [0, 0, 0] and of_small[0] > 0.3 and of_large[3] > of_small[3]
