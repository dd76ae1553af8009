"""One vocabulary of methods: every name comes back, wrong ones are explained, an object of one's own takes part."""

import numpy as np
import pytest
import scene
import torch

import omnistereo_lib as osl
from omnistereo_lib.evaluate import ABLATIONS, METHODS, SCALES, Scale, select_methods
from omnistereo_lib.stereo.methods import COSTS, CostEntry, Method, penalties
from omnistereo_lib.stereo.pipeline import sweep_depth


@pytest.mark.parametrize("method", {m.name: m for ms in (METHODS, *ABLATIONS.values()) for m in ms}.values(), ids=str)
def test_names_are_read_back(method):
    assert Method.parse(method.name) == method
    assert method.volume_key.aggregate == "none" and method.volume_key.volume_key == method.volume_key


def test_names_and_labels():
    assert [method.name for method in METHODS] == [
        "zncc", "mccnn", "sweepnet", "zncc+sgm", "mccnn+sgm", "sweepnet+sgm",
    ]  # fmt: skip
    method = Method.parse("sweepnet+sgm,weights=Plain_2,p1=0.20,wrap=false")
    assert method == Method(cost="sweepnet", aggregate="sgm", weights="Plain_2", p1=0.2, wrap=False)
    assert method.name == "sweepnet+sgm,weights=Plain_2,p1=0.2,wrap=false"
    assert method.label == "SweepNet + SGM, weights = Plain_2, p1 = 0.2, wrap = false"
    assert select_methods() == METHODS and len(select_methods(["zncc"], ["window"])) == 6
    ordered = [m.name for m in sorted(select_methods(ablations=["window"]), key=lambda m: m.sort_key)]
    assert ordered[:3] == ["zncc", "zncc,window=5", "zncc,window=13"] and ordered[3] == "zncc+sgm"
    assert {"window", "weights", "pairs", "wrap", "subindex", "penalties", "spheres"} == set(ABLATIONS)


def test_the_defaults_are_the_papers():
    for method in METHODS:
        assert (method.window, method.p1, method.p2, method.subindex) == (9, None, None, False)
    assert penalties(1200, 192) == (0.1, 12.0)
    assert SCALES["paper"] == Scale(1200, 300, 192) and SCALES["training"] == Scale(600, 150, 192)


def test_penalties_follow_the_scale(box):
    assert penalties(320, 64) == pytest.approx((0.1 * (320 / 1200) ** 0.5, 12 * (320 / 1200) ** 2 * 3))
    for width, num_spheres in ((8, 4000), (160, 40), (640, 8), (4800, 192)):
        p1, p2 = penalties(width, num_spheres)
        assert 0 < p1 <= p2 <= 12 and p1 <= 0.1
    p1, p2 = penalties(GRID.width, GRID.num_spheres)
    for given, both in (("", (p1, p2)), (",p1=5", (5, 5)), (",p2=0.001", (0.001, 0.001)), (",p1=0", (0, p2))):
        given, both = f"zncc+sgm{given}", "zncc+sgm,p1={},p2={}".format(*both)
        indices = [osl.estimate_depth(*box, GRID, name).index for name in (given, both)]
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
        osl.estimate_depth(rig, images, GRID, "zncc+sgm,window=5,pairs=all,p1=0.2,p2=3", subindex=False),
        osl.estimate_depth(rig, images, GRID, "zncc+sgm,pairs=all,p1=0.2,p2=3", osl.ZNCC(5), subindex=False),
    ):
        np.testing.assert_array_equal(depth.index, expected)


def test_the_number_of_spheres_is_a_setting(box):
    assert osl.estimate_depth(*box, GRID, "zncc,num_spheres=8").grid.num_spheres == 8


def test_an_object_of_your_own_is_a_cost(box):
    def second_sphere(spherical_images, pairs, columns=None):
        _, B, H, W = spherical_images.shape
        cost = torch.ones(H, W, B)
        cost[..., 2] = 0
        return cost

    assert (osl.estimate_depth(*box, GRID, "zncc", second_sphere, subindex=False).index % 16 == 2).all()


def test_a_network_of_your_own_is_a_cost_in_whatever_mode_it_is(box):
    for name, network in (("mccnn", osl.MCCNN.pretrained()), ("volumenet", osl.VolumeNet.pretrained())):
        expected = osl.estimate_depth(*box, GRID, name).index
        np.testing.assert_array_equal(osl.estimate_depth(*box, GRID, name, network.train()).index, expected)


def test_a_new_cost_joins_in_one_place(box, monkeypatch):
    entry = CostEntry("Mine", lambda method, path, precision: osl.ZNCC(3), frozenset(), p1=0.5, p2=1.5)
    monkeypatch.setitem(COSTS, "mine", entry)
    method = Method.parse("mine+sgm")
    assert (method.name, method.label) == ("mine+sgm", "Mine + SGM")
    p1, p2 = penalties(GRID.width, GRID.num_spheres, 0.5, 1.5)
    expected = osl.estimate_depth(*box, GRID, f"zncc+sgm,window=3,p1={p1},p2={p2}").index
    np.testing.assert_array_equal(osl.estimate_depth(*box, GRID, "mine+sgm").index, expected)


def test_a_network_is_read_once_per_process():
    assert Method.parse("mccnn").load_cost() is Method.parse("mccnn+sgm,pairs=all").load_cost()
    wrapped, cut = (Method.parse(name).load_cost() for name in ("sweepnet+sgm", "sweepnet+sgm,wrap=false"))
    assert wrapped.network.wrap and not cut.network.wrap
