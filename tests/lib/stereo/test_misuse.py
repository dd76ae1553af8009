"""Wrong arguments that `bad_inputs.py` lacks: each gets the library's error, at once."""

import dataclasses
import multiprocessing
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
import scene
import torch
from scene import refused

import omnistereo_lib as osl
from omnistereo_learn.recipes import SweepNetRecipe
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.stereo.cost import BlockCost
from omnistereo_lib.stereo.learned import LearnedCost
from omnistereo_lib.stereo.methods import COSTS, Method
from omnistereo_lib.stereo.pipeline import sweep_depth
from omnistereo_lib.stereo.sgm import sgm
from omnistereo_rigs import Checkerboard, calibrate_camera, calibrate_rig

RIG = scene.rig(width=60, height=56)
GRID = osl.SphereGrid(48, 12, num_spheres=4, min_depth=0.6)
IMAGES = [np.random.default_rng(k).integers(0, 255, (56, 60), np.uint8) for k in range(4)]
VOLUME = np.random.default_rng(0).random((6, 8, 4), np.float32)


class Flat(BlockCost):
    """A cost of the wrong shape."""

    def __call__(self, spherical_images, pairs, columns=None):
        return torch.zeros(1, 48, 4)


class Silent(BlockCost):
    """A cost that returns nothing."""

    def __call__(self, spherical_images, pairs, columns=None):
        pass


class Whole:
    """A cost that returns anything as its volume."""

    def __init__(self, volume):
        self.returned = volume

    def volume(self, sweep, images, pairs, progress=None):
        return self.returned


def depth(images=IMAGES, **options):
    return osl.estimate_depth(osl.Frame.of(RIG, images), GRID, **{"method": "zncc+sgm"} | options)


@pytest.mark.parametrize(
    "value",
    [
        torch.zeros(56, 60, dtype=torch.bfloat16),
        torch.zeros(56, 60).to_sparse(),
        torch.zeros(56, 60, device="meta"),
        torch.quantize_per_tensor(torch.zeros(56, 60), 1.0, 0, torch.quint8),
        np.full((56, 60), "gray", object),
        np.full((56, 60), None),
        np.full((56, 60), 1e300),
    ],
    ids=["bfloat16", "sparse", "meta", "quantised", "words", "objects", "infinite in float32"],
)
def test_images_that_are_no_numbers_are_one_error(value):
    with refused(r"image 1 .*; expected "):
        depth([value, *IMAGES[1:]])


@pytest.mark.parametrize("value", [1e12, -1e6, 65504.0])
def test_one_pixel_of_a_float_image_moves_no_ray_but_its_neighbours(value):
    images = [image.astype(np.float64) for image in scene.images(RIG)]
    before = depth(images, method="zncc").inverse_depth
    images[0] = images[0].copy()
    images[0][28, 30] = value
    after = depth(images, method="zncc").inverse_depth
    assert (~np.isclose(after, before, rtol=0.05, equal_nan=True)).sum() < 20


def test_a_float_image_without_such_pixels_is_taken_as_it_is():
    images = [image.astype(np.float32) for image in IMAGES]
    for image, taken in zip(images, osl.Frame.of(RIG, images).images, strict=True):
        assert taken is image


MASKED = np.ma.masked_array(np.ones((3, 3)), mask=np.eye(3))
LENS, POSE = RIG.cameras[0], osl.Pose.identity()
ON_A_BOARD = np.ma.masked_array(IMAGES[0], mask=IMAGES[0] > 100)


@pytest.mark.parametrize(
    "call",
    [
        lambda: depth([ON_A_BOARD, *IMAGES[1:]]),
        lambda: osl.cost_volume(SWEEP, [ON_A_BOARD, *IMAGES[1:]], osl.ZNCC()),
        lambda: osl.winner_takes_all(np.ma.masked_array(VOLUME, mask=VOLUME > 0.5)),
        lambda: osl.index_error(np.ones((3, 3)), MASKED, 16),
        lambda: POSE @ MASKED,
        lambda: LENS.project(MASKED),
        lambda: GRID.depth_to_index(MASKED),
        lambda: dataclasses.replace(LENS, mask=np.ma.masked_array(np.ones((56, 60)), mask=True)),
    ],
)
def test_masked_values_are_refused(call):
    """NumPy would compute with what is below the mask."""
    with pytest.raises(osl.OmnistereoError, match=r"has masked values; expected none. Fill them"):
        call()


@pytest.mark.parametrize(
    "numbers", ["far", [[1], [1, 2]], [None, 1], [1j], torch.ones(3).to_sparse()]
)
def test_what_is_no_array_of_real_numbers_is_one_error(numbers):
    for call in (
        lambda: POSE @ numbers,
        lambda: osl.Pose(numbers, np.zeros(3)),
        lambda: osl.Pose.from_vector(numbers),
        lambda: GRID.project(numbers),
        lambda: GRID.index_to_depth(numbers),
        lambda: GRID.depth_to_index(numbers),
        lambda: LENS.unproject(numbers),
        lambda: osl.index_error(numbers, np.ones((3, 3)), 16),
        lambda: osl.Depth(numbers, np.ones((3, 3)), SWEEP),
    ):
        with pytest.raises(osl.OmnistereoError, match="real numbers"):
            call()


@pytest.mark.parametrize(
    "volume",
    [
        torch.ones(4, 5, 6, device="meta"),
        torch.ones(4, 5, 6).to_sparse(),
        torch.quantize_per_tensor(torch.ones(4, 5, 6), 1.0, 0, torch.quint8),
        [[1, 2], [3]],
    ],
)
def test_a_volume_of_another_kind_is_one_error(volume):
    for function in (osl.sgm, osl.winner_takes_all, osl.confidence):
        with pytest.raises(osl.OmnistereoError, match=r"the cost volume is .*; expected"):
            function(volume)


@pytest.mark.parametrize("points", [[1.0, 2.0], np.zeros((3, 2)), 1.0, "far"])
def test_points_of_another_shape(points):
    with refused("points"):
        GRID.project(points)


def volume(cost):
    return osl.cost_volume(SWEEP, IMAGES, cost)


def rig(pose=0.0, min_depth=None):
    return osl.Rig(RIG.cameras, [osl.Pose(np.eye(3), [pose, 0, 0])] * 4, min_depth)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: osl.SphereGrid(96, 1_000_000_000), "height is 1000000000"),
        (lambda: osl.SphereSweep(RIG, GRID, device="mps"), "mps.*; expected .*cuda"),
        (lambda: depth([None] * 4), "image 1 holds object; expected real numbers"),
        (lambda: volume(Flat()), r"shape \(1, 48, 4\); expected .* \(12, 48, 4\)"),
        (lambda: osl.save_rig(RIG, "rig.json"), "rig.json: a rig is saved as YAML"),
        (lambda: osl.ZNCC(window="9"), "window is '9'"),
        (lambda: rig(1e8), r"camera 1 .* 100000000.0; expected a number of 0 to 1"),
        (lambda: rig(min_depth=-1.0), "min_depth.* is -1.0"),
        (lambda: sgm(torch.from_numpy(VOLUME + 1j)), "type torch.complex64; expected"),
        (lambda: volume(Silent()), r"gives None; expected .* \(12, 48, 4\)"),
        (lambda: volume(Whole(None)), "Whole.* returns None; expected a float tensor"),
        (lambda: volume(Whole(torch.zeros(4, 12, 48))), r"returns .* \(4, 12, 48\); expected"),
        (lambda: volume(Whole(SimpleNamespace(shape=(12, 48, 4)))), "Whole.* returns namespace"),
        (lambda: volume(osl.ZNCC), "cost is <class .*; expected an object"),
        (lambda: volume(osl.MCCNN().half()), "the network has weights of type torch.float16"),
        (lambda: volume(osl.MCCNN().to("meta")), "the network has no weights"),
        (lambda: depth(progress=None), "progress is None; expected Callable"),
        (lambda: sgm(1e38 * VOLUME), r"a cost is infinite, or 1e\+30 or more"),
        (lambda: sgm(VOLUME, p2=1e38), r"p2 = 1e\+38; expected"),
        (lambda: sgm(None), "holds object"),
        (lambda: osl.confidence("abc"), "the cost volume holds"),
        (lambda: SweepNetRecipe(steps=2.5), "steps = 2.5; expected"),
        (lambda: SweepNetRecipe(seed=-1), "seed = -1"),
    ],
)
def test_wrong_arguments(call, message):
    with refused(message) as error:
        call()
    assert len(str(error.value)) < 400


SWEEP = osl.SphereSweep(RIG, GRID)
BOARD = Checkerboard((4, 3), 0.06)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("rig", lambda wrong: osl.Frame.of(wrong, IMAGES)),
        ("images", lambda wrong: osl.Frame.of(RIG, wrong)),
        ("grid", lambda wrong: osl.estimate_depth(osl.Frame.of(RIG, IMAGES), wrong)),
        ("method", lambda wrong: osl.estimate_depth(osl.Frame.of(RIG, IMAGES), GRID, wrong)),
        ("rig", lambda wrong: osl.SphereSweep(wrong, GRID)),
        ("grid", lambda wrong: osl.SphereSweep(RIG, wrong)),
        ("rig", lambda wrong: camera_pairs("ring", wrong)),
        ("T_rig_cam", lambda wrong: RIG.with_poses(wrong)),
        ("T_new_rig", lambda wrong: RIG.transformed(wrong)),
        ("path", lambda wrong: osl.save_rig(RIG, wrong)),
        ("path", lambda wrong: osl.load_rig(wrong)),
        ("path", lambda wrong: osl.SweepNet.from_file(wrong)),
        ("paths", lambda wrong: osl.load_images(wrong)),
        ("folder", lambda wrong: osl.load_dataset(wrong)),
        ("network", lambda wrong: LearnedCost(wrong)),
        ("views", lambda wrong: calibrate_camera(wrong, BOARD)),
        ("board", lambda wrong: calibrate_camera([VOLUME[0]], wrong)),
        ("views", lambda wrong: calibrate_rig(wrong, BOARD)),
        ("board", lambda wrong: calibrate_rig([[VOLUME[0]]] * 2, wrong)),
    ],
)
def test_wrong_types(name, call):
    for wrong in (None, 5, object()):
        with refused(rf"^{name} is .*; expected ") as error:
            call(wrong)
        assert len(str(error.value)) < 200


def test_what_was_checked_does_not_change_afterwards():
    t, poly = np.zeros(3), np.array(RIG.cameras[0].poly)
    pose, camera = osl.Pose(np.eye(3), t), dataclasses.replace(RIG.cameras[0], poly=poly)
    t[0], poly[0] = 1, -1
    assert (pose.t == 0).all() and camera.poly[0] == RIG.cameras[0].poly[0]


@pytest.mark.parametrize("method", ["zncc+sgm", "volumenet"])
def test_costs_that_require_grad_are_read(monkeypatch, method):
    """In place of a cost whose errors were measured: its evidence is read, too."""
    cost, own = Method.parse(method).cost, Whole(torch.rand(12, 48, 4, requires_grad=True))
    monkeypatch.setitem(COSTS, cost, dataclasses.replace(COSTS[cost], load=lambda *_: own))
    assert np.isfinite(depth(method=method).sigma).all()


def test_float64_as_the_default_of_torch_changes_nothing():
    expected = sweep_depth(osl.SphereSweep(RIG, GRID), IMAGES, "volumenet")
    torch.set_default_dtype(torch.float64)
    try:
        found = sweep_depth(osl.SphereSweep(RIG, GRID), IMAGES, "volumenet")
    finally:
        torch.set_default_dtype(torch.float32)
    np.testing.assert_array_equal(found.index, expected.index)


def test_costs_that_are_large_stay_finite():
    volume = 1e29 * VOLUME
    volume[2, 3, 1] = np.nan
    assert (sgm(volume).isfinite() == torch.from_numpy(volume).isfinite()).all()


def test_what_is_frozen_cannot_be_written_into():
    camera = dataclasses.replace(RIG.cameras[0], mask=np.ones((56, 60)))
    found = depth()
    pose = RIG.T_rig_cam[0]
    arrays = pose.R, pose.t, camera.poly, camera.inv_poly, camera.mask
    for array in (*arrays, found.index, found.confidence):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def sent(value):
    """Return a value as a process pool hands it over."""
    queue = multiprocessing.Queue()
    queue.put(value)
    return queue.get(timeout=60)


@pytest.mark.parametrize("copy", [deepcopy, sent])
def test_copies_do_what_the_original_does(copy):
    """As joblib, Dask or a process pool make them. A sweep leaves its tables behind."""
    expected = depth(method="sweepnet")
    kept = copy(expected)
    np.testing.assert_array_equal(kept.depth, expected.depth)
    again = sweep_depth(kept.sweep, IMAGES, copy(Method.parse("sweepnet")))
    np.testing.assert_array_equal(again.index, expected.index)
    np.testing.assert_array_equal(copy(RIG).cameras[0].poly, RIG.cameras[0].poly)
    assert {copy(GRID), copy(Method.parse("zncc")), GRID} == {GRID, Method.parse("zncc")}
    assert len({copy(RIG), RIG, RIG.T_rig_cam[0]}) == 3  # by identity
    assert str(copy(osl.OmnistereoError("wrong"))) == "wrong"


def test_right_types_of_every_kind(tmp_path):
    """A path may be text, a sequence an array; numbers of NumPy are left to the function."""
    osl.save_rig(RIG, str(tmp_path / "rig.yaml"))
    assert (
        len(osl.load_rig(tmp_path / "rig.yaml"))
        == len(osl.load_rig(path=str(tmp_path / "rig.yaml"), unit=None))
        == 4
    )
    tensors = torch.from_numpy(np.stack(IMAGES))
    for images in (np.stack(IMAGES), tensors, tensors.float().requires_grad_(), tuple(IMAGES)):
        np.testing.assert_array_equal(depth(images).index, depth().index)


@pytest.mark.parametrize(
    "change",
    [
        lambda volume: volume[:, ::-1][:, ::-1],
        lambda volume: np.ascontiguousarray(volume[::-1])[::-1],
        lambda volume: volume.astype(">f4"),
        lambda volume: np.asfortranarray(volume),
        lambda volume: volume.astype(np.float64),
        lambda volume: torch.from_numpy(volume).requires_grad_(),
    ],
)
def test_volumes_of_any_layout(change):
    before = VOLUME.copy()
    torch.testing.assert_close(sgm(change(VOLUME)), sgm(VOLUME), rtol=0, atol=0)
    assert (osl.winner_takes_all(change(VOLUME)) == osl.winner_takes_all(VOLUME)).all()
    np.testing.assert_array_equal(VOLUME, before)
