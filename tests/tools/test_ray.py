"""Why a ray has its depth: each kind of sentence on images whose depth is known, and the numbers
behind it."""

import os
from collections import Counter
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from course.figures import plot
from omnistereo_tools.judge import ray

RAYS = int(os.environ.get("RAYS", "40"))


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
    assert "agrees" in {one.kind for one in found}


def test_the_effect_of_a_tilt_is_the_angle_over_the_baseline():
    ahead = np.array([0.0, 0, 1])
    for baseline, depth in ((0.2, 10.0), (1.0, 30.0)):
        centers = np.array([[-baseline / 2, 0, 0], [baseline / 2, 0, 0]])
        shift = ray.tilt_shift(ahead, 1 / depth, centers)
        assert shift == pytest.approx(np.radians(0.1) / baseline, rel=0.01)
    assert np.isnan(ray.tilt_shift(ahead, 0.1, centers[:1]))


def test_the_figure_of_a_ray_shows_its_numbers(box):
    costs = np.random.default_rng(0).uniform(1, 3, (40, 160, 64))
    one, figure = (
        ray.explain(box, 80, 20),
        plot.explain_ray(box, 80, 20, box.index, {"cost": costs}),
    )
    assert figure.get_suptitle() == one.sentence
    along = figure.axes[0].lines[0].get_ydata()
    np.testing.assert_array_equal(along, one.agreement)
    (drawn,) = [
        line.get_ydata() for line in figure.axes[0].lines if line.get_label().startswith("cost, ")
    ]
    assert np.ptp(drawn) == pytest.approx(1) and np.corrcoef(drawn, costs[20, 80])[
        0, 1
    ] == pytest.approx(1)
    crosses = [line for ax in figure.axes for line in ax.lines if line.get_marker() == "+"]
    assert len(crosses) == one.sees.sum() > 1
    plt.close(figure)


@pytest.mark.parametrize("kind", ray.SENTENCES)
def test_each_kind_of_sentence_has_its_rule(box, kind):
    one = ray.explain(box, 80, 20)
    n, zero = round(one.index), np.full(64, 0.0)
    bump = np.exp(-((np.arange(64) - n) ** 2) / 8.0)
    away = np.exp(-((np.arange(64) - (n + 25) % 64) ** 2) / 8.0)
    four, none = np.ones(4, bool), np.zeros(4, bool)
    base = {"sees": four, "hidden": none, "contrast": 20.0, "agreement": 0.9 * bump}
    changed = {
        "unseen": {"sees": np.arange(4) == 0},
        "hidden": {"hidden": np.arange(4) > 0},
        "flat": {"contrast": 0.5},
        "agrees": {},
        "repeats": {"agreement": 0.9 * bump + 0.85 * away},
        "elsewhere": {"agreement": 0.3 * bump + 0.85 * away},
        "unlike": {"agreement": zero + 0.3 * bump},
    }[kind]
    assert replace(one, **base, **{}).kind == "agrees"
    assert replace(one, **(base | changed)).kind == kind
    assert "{" not in replace(one, **(base | changed)).sentence


def test_four_of_five_sentences_are_right_on_rendered_frames(capsys):
    """On frames with exact depth, by VolumeNet. What a sentence claims is looked up in the exact
    depth:

    agrees, elsewhere: the depth is right, within `tolerance`; repeats: it or the other one is;
    unlike: even at the exact depth the patches differ; flat: there is as little texture at the
    exact depth; unseen, hidden: fewer than two cameras see the exact point."""
    rng, kinds, right = np.random.default_rng(0), Counter(), Counter()
    for name in ("sunny", "indoor"):
        frame = osl.load_dataset(f"data_samples/{name}", split="test")[0]
        grid = osl.SphereGrid(320, 80, num_spheres=64, min_depth=frame.rig.min_depth)
        depth, gt = osl.estimate_depth(frame, grid, "volumenet"), frame.gt_index(grid)
        exact = osl.Depth(gt.astype(np.float32), depth.confidence, depth.sweep, frame.images)
        for cell in rng.choice(np.flatnonzero(np.isfinite(gt)), RAYS // 2, replace=False):
            row, column = divmod(int(cell), grid.width)
            one, truth = ray.explain(depth, column, row), ray.explain(exact, column, row)
            kinds[one.kind] += 1
            right[one.kind] += is_right(one, truth)
    with capsys.disabled():
        print(
            "\n"
            + ", ".join(
                f"{kind}: {right[kind]} of {count} right" for kind, count in kinds.most_common()
            )
        )
    assert right.total() >= 0.8 * RAYS


def is_right(one, truth):
    off = abs(one.index - truth.index) <= ray.tolerance(truth.index)
    if one.kind in ("unseen", "hidden"):
        return (truth.sees & ~truth.hidden).sum() < 2
    if one.kind == "flat":
        return truth.contrast < 2 * ray.FLAT
    if one.kind == "unlike":
        return not truth.chosen >= ray.ALIKE
    other = one.kind == "repeats" and abs(one.rival.sphere - truth.index) <= ray.tolerance(
        truth.index
    )
    return bool(off or other)
