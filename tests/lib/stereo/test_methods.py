"""One vocabulary of methods: names come back, wrong ones are explained, own costs join."""

import doctest
import multiprocessing
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy

import numpy as np
import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_learn.evaluate import ABLATIONS, METHODS, select_methods
from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_lib.stereo import methods
from omnistereo_lib.stereo.methods import COSTS, CostEntry, Method, penalties
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.zncc import default_window

pytestmark = pytest.mark.usefixtures("small")


@pytest.mark.parametrize(
    "method", {m.name: m for ms in (METHODS, *ABLATIONS.values()) for m in ms}.values(), ids=str
)
def test_names_are_read_back(method):
    assert EvaluatedMethod.parse(method.name) == method
    assert method.volume_key.aggregate == "none"
    assert method.volume_key.volume_key == method.volume_key


def test_names_and_labels():
    costs = ["zncc", "mccnn", "sweepnet"]
    assert [method.name for method in METHODS] == costs + [f"{cost}+sgm" for cost in costs]
    method = Method.parse("sweepnet+sgm,weights=Plain_2,p1=0.20,wrap=false")
    assert method == Method(cost="sweepnet", aggregate="sgm", weights="Plain_2", p1=0.2, wrap=False)
    assert method.name == "sweepnet+sgm,weights=Plain_2,p1=0.2,wrap=false"
    assert method.label == "SweepNet + SGM, weights = Plain_2, p1 = 0.2, wrap = false"
    assert select_methods() == METHODS and len(select_methods(["zncc"], ["window"])) == 8
    ordered = [
        m.name for m in sorted(select_methods(ablations=["window"]), key=lambda m: m.sort_key)
    ]
    assert ordered[:5] == ["zncc", "zncc,window=3", "zncc,window=9", "zncc,window=13", "zncc+sgm"]
    assert {"window", "weights", "pairs", "wrap", "subindex", "penalties", "spheres"} == set(
        ABLATIONS
    )


def test_the_window_follows_the_scale(box):
    assert [default_window(width) for width in (8, 320, 600, 640, 1280, 4800)] == [5, 5, 7, 7, 9, 9]
    rig, images = box
    five, default, nine = (
        osl.cost_volume(osl.SphereSweep(rig, GRID), images, osl.ZNCC(w)) for w in (5, None, 9)
    )
    assert torch.equal(default.nan_to_num(9), five.nan_to_num(9)) and not torch.equal(default, nine)


def test_penalties_follow_the_scale(box):
    assert penalties(320, 64) == pytest.approx(
        (0.1 * (320 / 1200) ** 0.5, 12 * (320 / 1200) ** 2 * 3)
    )
    for width, num_spheres in ((8, 4000), (160, 40), (640, 8), (4800, 192)):
        p1, p2 = penalties(width, num_spheres)
        assert 0 < p1 <= p2 <= 12 and p1 <= 0.1
    p1, p2 = penalties(GRID.width, GRID.num_spheres)
    expected = {"": (p1, p2), ",p1=5": (5, 5), ",p2=0.001": (0.001, 0.001), ",p1=0": (0, p2)}
    for given, both in expected.items():
        given, both = f"zncc+sgm{given}", "zncc+sgm,p1={},p2={}".format(*both)
        indices = [
            osl.estimate_depth(osl.Frame.of(*box), GRID, name).index for name in (given, both)
        ]
        np.testing.assert_array_equal(*indices)


# ---- from images to depth

GRID = osl.SphereGrid(160, 40, (-40, 40), 24, 0.6)


@pytest.fixture(scope="module")
def box():
    rig = scene.rig()
    return rig, scene.images(rig)


def test_a_name_is_what_its_parts_are(box):
    rig, images = box
    sweep = osl.SphereSweep(rig, GRID)
    volume = osl.sgm(osl.cost_volume(sweep, images, osl.ZNCC(5), "all"), 0.2, 3.0)
    expected = osl.winner_takes_all(volume)
    for depth in (
        sweep_depth(sweep, images, "zncc+sgm,window=5,pairs=all,p1=0.2,p2=3", subindex=False),
        osl.estimate_depth(
            osl.Frame.of(rig, images),
            GRID,
            "zncc+sgm,window=5,pairs=all,p1=0.2,p2=3",
            subindex=False,
        ),
    ):
        np.testing.assert_array_equal(depth.index, expected)


@pytest.mark.parametrize("name", ["zncc", "zncc+sgm", "volumenet+sgm"])
def test_a_name_that_says_so_does_not_refine(box, name):
    method = Method.parse(f"{name},subindex=false")
    assert method.name == f"{name},subindex=false"
    index = osl.estimate_depth(osl.Frame.of(*box), GRID, method).index
    np.testing.assert_array_equal(
        index, osl.estimate_depth(osl.Frame.of(*box), GRID, name, subindex=False).index
    )
    assert (index[np.isfinite(index)] % 1 == 0).all()


def test_the_example_of_a_cost_of_your_own(monkeypatch):
    monkeypatch.setattr(methods, "COSTS", dict(COSTS))
    runner, example = doctest.DocTestRunner(), methods.CostEntry.__doc__
    runner.run(
        doctest.DocTestParser().get_doctest(example, dict(vars(methods)), "CostEntry", None, None)
    )
    assert runner.failures == 0 and runner.tries > 4 and "difference" in methods.COSTS


def test_a_cost_that_is_registered_again_takes_the_place_of_the_first(box, monkeypatch):
    """As when the cell of a notebook runs twice."""
    sweep = osl.SphereSweep(box[0], GRID)
    for window in (3, 5):
        monkeypatch.setitem(
            COSTS, "mine", CostEntry("Mine", lambda *_, size=window: osl.ZNCC(size))
        )
        found, expected = (
            sweep_depth(sweep, box[1], name).index for name in ("mine", f"zncc,window={window}")
        )
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", ["mccnn", "volumenet"])
def test_a_network_is_a_cost_in_whatever_mode_it_is(box, name):
    sweep, method = osl.SphereSweep(box[0], GRID), Method.parse(name)
    network = {"mccnn": osl.MCCNN, "volumenet": osl.VolumeNet}[name].pretrained().train()
    found = osl.cost_volume(sweep, box[1], network)
    # a training that looks at a frame goes on
    assert all(module.training for module in network.modules())
    expected = osl.cost_volume(sweep, box[1], method.load_cost())
    torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)


def test_a_sweep_keeps_its_networks(box):
    sweep, other = (osl.SphereSweep(box[0], GRID) for _ in range(2))
    kept = Method.parse("mccnn").cost_of(sweep)
    assert Method.parse("mccnn+sgm").cost_of(sweep) is kept
    assert Method.parse("mccnn").cost_of(other) is not kept
    wrapped, cut = (
        Method.parse(name).cost_of(sweep) for name in ("sweepnet+sgm", "sweepnet+sgm,wrap=false")
    )
    assert wrapped.network.wrap and not cut.network.wrap


@pytest.mark.parametrize("kind", [osl.MCCNN, osl.SweepNet, osl.VolumeNet])
def test_networks_are_copied_and_sent_after_use_and_serve_two_threads(box, kind):
    grid = osl.SphereGrid(64, 16, (-40, 40), 16, 0.6)
    sweep, network = osl.SphereSweep(box[0], grid), kind.pretrained()
    expected = osl.cost_volume(sweep, box[1], network)
    queue = multiprocessing.Queue()  # as to another process
    queue.put(network)
    for copied in (deepcopy(network), queue.get(timeout=60)):
        assert torch.equal(
            osl.cost_volume(sweep, box[1], copied).nan_to_num(), expected.nan_to_num()
        )
    sweeps = [sweep, *(osl.SphereSweep(box[0], grid) for _ in range(3))]
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(lambda one: osl.cost_volume(one, box[1], network), sweeps):
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-6, equal_nan=True)
