"""Why a ray has its depth: each kind of sentence where depth is known, and its numbers."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from course.figures import plot
from omnistereo_tools.judge import ray


@pytest.fixture(scope="module")
def box():
    """The exact depth of a textured box, with its images."""
    rig, grid = (
        scene.rig(width=200, height=192),
        osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6),
    )
    return scene.true_depth(rig, grid, scene.images(rig, finest=0.12))


def test_the_agreement_is_greatest_at_the_exact_depth(box):
    rays = [(row, column) for row in (10, 20, 30) for column in range(5, 160, 20)]
    found = [ray.explain(box, column, row) for row, column in rays]
    seen = [(one, box.index[cell]) for one, cell in zip(found, rays, strict=True) if one.modes]
    off = [abs(one.modes[0].sphere - exact) for one, exact in seen]
    assert len(off) > 15 and np.mean(np.array(off) <= 1.5) > 0.9
    assert "weak" in {one.kind for one in found}  # without error bars nothing is sure


def test_the_figure_of_a_ray_shows_its_numbers(box):
    costs = np.random.default_rng(0).uniform(1, 3, (40, 160, 64))
    one = ray.explain(box, 80, 20)
    figure = plot.explain_ray(box, 80, 20, box.index, {"cost": costs})
    assert figure.get_suptitle() == one.sentence
    along = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_array_equal(along, one.agreement)
    (drawn,) = [
        line.get_ydata() for line in figure.axes[0].lines if line.get_label().startswith("cost, ")
    ]
    assert np.ptp(drawn) == pytest.approx(1)
    assert np.corrcoef(drawn, costs[20, 80])[0, 1] == pytest.approx(1)
    crosses = [line for ax in figure.axes for line in ax.lines if line.get_marker() == "+"]
    assert len(crosses) == one.sees.sum() > 1
    plt.close(figure)


@pytest.mark.parametrize("kind", ray.SENTENCES)
def test_each_kind_of_sentence_has_its_rule(box, kind):
    one = ray.explain(box, 80, 20)
    n, pairs = round(one.index), np.ones((6, 1))
    bump = pairs * np.exp(-((np.arange(64) - n) ** 2) / 8.0)
    away = pairs * np.exp(-((np.arange(64) - (n + 25) % 64) ** 2) / 8.0)
    base = {"sees": np.ones(4, bool), "contrast": 20.0, "scores": 0.5 * bump, "likely": 0.95}
    base["nearest"] = np.nan
    changed = {
        "unseen": {"scores": np.nan * bump},
        "flat": {"contrast": 0.5},
        "agrees": {},
        "weak": {"likely": 0.6},
        "decided": {"scores": 0.5 * bump + 0.45 * away},
        "either": {"scores": 0.5 * bump + 0.45 * away, "likely": np.nan},
        "elsewhere": {"scores": 0.5 * bump + 0.8 * away, "likely": 0.6},
        "wide": {"scores": 0.5 * pairs + 0.05 * bump},
        "unlike": {"scores": 0.2 * bump},
    }[kind]
    assert replace(one, **base).kind == "agrees"
    found = replace(one, **(base | changed))
    assert found.kind == kind and "{" not in found.sentence
    if "{depth}" in ray.SENTENCES[kind]:
        assert f"{found.depth:.2f} m" in found.sentence


def test_a_ray_is_unseen_only_if_no_depth_has_two_cameras(box):
    """On the sample, the road below was estimated too near, where one camera saw it."""
    one = ray.explain(box, 80, 20)
    n = round(one.index)
    bump = np.ones((6, 1)) * np.exp(-((np.arange(64) - (n + 25) % 64) ** 2) / 8.0)
    scores = np.where(np.abs(np.arange(64) - n) < 8, np.nan, 0.5 * bump)
    found = replace(one, scores=scores, sees=np.arange(4) == 0, contrast=20.0, likely=0.3)
    assert found.kind == "elsewhere"


def test_depths_that_agree_as_well_as_the_estimate_without_a_valley_are_a_plateau(box):
    """Such as white paint and the sky: they are named as a range, not as second depths."""
    one = ray.explain(box, 80, 20)
    n = round(one.index)
    scores = np.where((np.arange(64) > n - 10) & (np.arange(64) < n + 15), 0.5, 0.1) * np.ones(
        (6, 1)
    )
    found = replace(one, scores=scores, sees=np.ones(4, bool), contrast=20.0, likely=0.6)
    assert found.plateau == (n - 9, n + 14) and found.kind == "wide" and found.rival is None
    ends = [ray.told(float(box.grid.index_to_depth(at))) for at in (n + 14, n - 9)]
    assert f"from {ends[0]} to {ends[1]}" in found.sentence


def test_a_second_depth_is_an_edge_if_it_is_found_around_and_else_a_look_alike(box):
    one = ray.explain(box, 80, 20)
    n = round(one.index)
    away = (n + 25) % 64
    bumps = (np.exp(-((np.arange(64) - at) ** 2) / 8.0) for at in (n, away))
    scores = np.ones((6, 1)) * sum(0.5 * bump for bump in bumps)
    two = replace(one, scores=scores, sees=np.ones(4, bool), contrast=20.0, likely=0.6)
    for beside, note in ((0, "look-alike"), (2, ""), (5, "edge"), (40, "edge")):
        around = np.full(49, one.index)
        around[:beside] = away
        found = replace(two, around=around.reshape(7, 7))
        assert (found.kind, found.note) == ("either", note)
        assert found.sentence.count(ray.told(float(box.grid.index_to_depth(away)))) == 1 + (
            note != ""
        )


def test_depths_that_change_smoothly_to_a_second_one_are_a_slope_and_no_edge(box):
    """Such as the road, which reaches many depths within a few degrees."""
    one = ray.explain(box, 80, 20)
    n = round(one.index)
    beside = n + 5
    bumps = (np.exp(-((np.arange(64) - at) ** 2) / 2.0) for at in (n, beside))
    scores = np.ones((6, 1)) * sum(0.5 * bump for bump in bumps)
    two = replace(one, scores=scores, sees=np.ones(4, bool), contrast=20.0, likely=0.6)
    assert two.rival.sphere == beside and ray.tolerance(n) < 5
    rows = n + np.linspace(-5, 5, 7)
    slope, edge = (np.tile(at[:, None], 7) for at in (rows, np.where(rows > n + 1, beside, n)))
    for around in (slope, slope.T, np.where(np.eye(7), np.nan, slope)):
        assert replace(two, around=around).note == ""
    beyond = np.where(np.arange(7) == 6, 60.0, rows)  # an edge, but to what is nearer than that
    assert replace(two, around=np.tile(beyond, (7, 1))).note == ""
    blurred = np.where(rows == rows[4], (n + beside) / 2, edge[:, 0])
    for around in (edge, edge.T, np.tile(blurred, (7, 1))):
        assert replace(two, around=around).note == "edge"


def test_a_depth_that_is_not_certain_is_told_with_the_near_end_of_its_bound(box):
    one = ray.explain(box, 80, 20)
    bump = np.ones((6, 1)) * np.exp(-((np.arange(64) - round(one.index)) ** 2) / 8.0)
    weak = replace(one, scores=0.5 * bump, sees=np.ones(4, bool), contrast=20.0, likely=0.6)
    assert replace(weak, nearest=4.714).sentence.endswith(
        "It is unlikely to be nearer than 4.71 m."
    )
    assert replace(weak, nearest=np.nan).note == ""


def test_the_cameras_that_agree_are_counted_where_they_agree_best(box):
    """The estimate lies between two spheres, the peak beside it, of three cameras."""
    one = ray.explain(box, 80, 20)
    scores = np.zeros((6, 64))
    scores[[0, 1, 3], round(one.index) + 1] = 0.5, 0.4, 0.3  # cameras 1-2, 1-3, 2-3
    found = replace(one, scores=scores, sees=np.ones(4, bool))
    assert (found.peak.sphere, found.alike) == (round(one.index) + 1, 3)
    assert replace(one, scores=0.02 * scores, sees=np.ones(4, bool)).alike == 3  # never none
