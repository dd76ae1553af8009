"""One search finds every numbered equation and table of the paper in the docstring of what computes it."""

import pytest

from course.library import docstrings
from course.paper_map import PLACES, mentions

COMPUTED_BY = {
    "Eq. 1": {"stereo.sweep.SphereSweep.warp", "stereo.sweep.SphereSweep.warp_block"},
    "Eq. 2": {"stereo.volume.cost_volume"},
    "Table I": {"stereo.sweepnet.SweepNet"},
    "Eq. 3": {"train.spheres.SphereSamples.micro_batch"},
    "Eq. 4": {"train.spheres.SphereObjective"},
    "Eq. 5": {"stereo.metrics.error_map"},
    "Table II": {"evaluate.table.errors_table", "stereo.metrics.index_error"},
    "Section III-A": {"geometry.camera.OcamCamera.project", "calibrate.rig.calibrate_rig"},
    "Section III-B": {"geometry.sphere.SphereGrid", "stereo.sgm.sgm", "stereo.depth.winner_takes_all"},
    "Section III-C": {"stereo.sweepnet"},
}


@pytest.mark.parametrize("place", COMPUTED_BY)
def test_a_search_finds_it(place):
    found = {name.removeprefix("omnistereo_lib.") for name, text in docstrings().items() if place in mentions(text)}
    assert found >= COMPUTED_BY[place]


def test_no_equation_and_no_table_is_left_out():
    numbered = {place for place in PLACES if place.startswith(("Eq.", "Table"))}
    assert numbered == {f"Eq. {k}" for k in range(1, 6)} | {"Table I", "Table II"} <= set(COMPUTED_BY)
