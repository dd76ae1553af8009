"""The renderer: lens, rig, drive, layout and files without Blender; the frames that ship; one tiny frame with it."""

import hashlib
import itertools
import json
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import omnistereo_lib as osl
import render
from omnistereo_lib.errors import OmnistereoError
from render import frames as frames_module
from render import main
from render.drive import ROUTES, plan_drive
from render.frames import (
    SEED,
    SETS,
    forget_partial,
    is_complete,
    render_set,
    renew_manifest,
    select_shard,
    write_manifest,
)
from render.layout import HALF_STREET, LANE, STREETS, plan_district, split_lots
from render.lens import SENSOR_MM, fit_ocam, random_lens
from render.rig import Sensor, _yaml_float, make_rig, write_config
from render.sensor import _tone, develop
from render.traffic import Traffic
from render.vehicles import BODIES

SAMPLES = Path(osl.__file__).parents[1] / "data_samples" / "sunny"
DISTRICT = plan_district(SEED)


# The lens


def blender_pixel(lens, directions, size):
    """Where Cycles draws directions (n, 3): θ of its polynomial, solved by bisection, then its shift."""
    width, height = size
    k = np.array(lens.blender_coefficients())
    theta = np.arctan2(np.hypot(*directions.T[:2]), directions[:, 2])
    low, high = np.zeros(len(theta)), np.full(len(theta), SENSOR_MM / 2 * 1.1)
    for _ in range(60):
        middle = (low + high) / 2
        beyond = -np.polynomial.polynomial.polyval(middle, k) > theta
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    radius = low / SENSOR_MM * width
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    shift_x, shift_y = lens.blender_shift()
    u = (width - 1) / 2 - shift_x * width + radius * np.cos(azimuth)
    v = (height - 1) / 2 + shift_y * height + radius * np.sin(azimuth)
    return np.stack([u, v], -1)


def directions(max_deg):
    theta, azimuth = np.meshgrid(np.radians(np.linspace(0, max_deg, 56)), np.linspace(0, 2 * np.pi, 24))
    rays = [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)]
    return np.stack(rays, -1).reshape(-1, 3)


@given(st.integers(0, 2**32), st.floats(0, np.radians(113)))
@settings(deadline=None)
def test_lens_radius_is_the_inverse_of_theta(seed, theta):
    lens = random_lens(np.random.default_rng(seed))
    assert lens.theta(lens.radius(theta)) == pytest.approx(theta, abs=1e-12)


@given(st.integers(0, 2**32))
@settings(max_examples=5, deadline=None)
def test_ocam_polynomials_fit_the_lens(seed):
    lens = random_lens(np.random.default_rng(seed))
    for width in (800, 400):
        fit = fit_ocam(lens, width)
        assert max(fit.residual_px, fit.inverse_residual_px) < 2e-3
        camera = osl.OcamCamera(fit.poly, fit.inv_poly, fit.centre, (1, 0, 0), (width, width * 96 // 100))
        assert camera.inverse_poly_error_px() < 5e-3


@pytest.mark.parametrize("size", [(800, 768), (400, 384)])
@pytest.mark.parametrize("name", ["van", "handheld"])
def test_written_rig_sees_what_blender_draws(name, size, tmp_path):
    rig = make_rig(SEED, name)
    write_config(tmp_path / "config.yaml", rig, size, {"img_fmt": "cam%d/%04d.jpg", "start": 1})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = osl.Rig.load(tmp_path)
    assert loaded.min_depth == rig.min_depth
    for camera, pose, made in zip(loaded.cameras, loaded.T_rig_cam, rig.cameras, strict=True):
        assert camera.image_size == size and camera.max_fov_deg == 220
        np.testing.assert_allclose(pose.R, made.T_rig_cam.R, atol=1e-12)
        np.testing.assert_array_equal(pose.t, made.T_rig_cam.t)
        rays = directions(110)
        uv, valid = camera.project(rays)
        expected = blender_pixel(made.lens, rays, size)
        assert np.abs(uv - expected).max() < 0.01
        np.testing.assert_array_equal(valid, camera.contains(expected))
        assert valid.mean() > 0.95


def test_config_names_each_camera_and_says_what_only_a_rendered_rig_knows(tmp_path):
    rig = make_rig(SEED)
    write_config(tmp_path / "config.yaml", rig, (800, 768), {"img_fmt": "cam%d/%04d.jpg", "start": 701})
    content = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert content["dataset"] == {"img_fmt": "cam%d/%04d.jpg", "start": 701}
    for number, (entry, camera) in enumerate(zip(content["cameras"], rig.cameras, strict=True), 1):
        assert entry["cam_id"] == number and entry["img_dir"] == f"cam{number}"
        for key, value in (("exposure_gain", camera.sensor.gain), ("falloff", camera.sensor.falloff)):
            assert entry[key] == pytest.approx(value, abs=1e-6)
        assert entry["fit_residual_px"] < 2e-3


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(deadline=None)
def test_numbers_survive_yaml(value):
    assert yaml.safe_load(_yaml_float(value)) == value
    assert isinstance(yaml.safe_load(_yaml_float(value)), float)


# The rig and the sensor


@pytest.mark.parametrize(("name", "baseline"), [("van", 0.6), ("handheld", 0.15 * np.sqrt(2))])
def test_rig_stands_around_its_centre(name, baseline):
    rig = make_rig(SEED, name)
    centres = np.stack([camera.T_rig_cam.t for camera in rig.cameras])
    np.testing.assert_allclose(centres.mean(0), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(centres, axis=1), baseline, rtol=0.05)
    for camera, forward in zip(rig.cameras, np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]]), strict=True):
        assert camera.T_rig_cam.R[:, 2] @ forward > np.cos(np.radians(4))
        assert camera.T_rig_cam.t @ forward > 0.9 * baseline


def test_rig_comes_from_its_seed_alone():
    def numbers(rig):
        cameras = ((*c.T_rig_cam.as_vector(), *c.lens.k, *c.lens.centre, *vars(c.sensor).values()) for c in rig.cameras)
        return np.array(list(cameras))

    np.testing.assert_array_equal(numbers(make_rig(7)), numbers(make_rig(7)))
    assert (numbers(make_rig(7)) != numbers(make_rig(8))).all()
    assert len(np.unique(numbers(make_rig(7)))) == numbers(make_rig(7)).size  # no two cameras share anything


QUIET = Sensor(gain=1.0, read_noise=0.0, shot_noise=0.0, falloff=0.15)
LENS = make_rig(SEED).cameras[0].lens


def light(picture):
    """Linear signal of pixel values: the tone curve, read backwards."""
    signal = np.linspace(0, 4, 200_001)
    return np.interp(picture / 255.0, _tone(signal), signal)


def test_developed_picture_is_dark_at_the_rim():
    picture = develop(np.full((768, 800, 3), 0.3), LENS, QUIET, 1.0, False, np.random.default_rng(0))
    assert picture.shape == (768, 800, 3) and picture.dtype == np.uint8
    u, v = np.rint(LENS.centre).astype(int)
    rim = int(u - LENS.radius(np.radians(110)))
    assert light(picture[v, u]) == pytest.approx([0.3] * 3, rel=0.01)
    assert light(picture[v, rim]) == pytest.approx([0.3 * 0.85] * 3, rel=0.01)


def test_developed_noise_is_that_of_the_sensor():
    sensor = Sensor(gain=0.9, read_noise=0.02, shot_noise=2e-3, falloff=0.0)
    picture = develop(np.full((384, 400, 3), 0.25), LENS, sensor, 1.1, True, np.random.default_rng(0))
    assert picture.shape == (384, 400)
    signal = 0.25 * 1.1 * 0.9
    assert light(picture).mean() == pytest.approx(signal, rel=0.01)
    assert light(picture).std() == pytest.approx(np.sqrt(0.02**2 + 2e-3 * signal), rel=0.02)


@given(st.floats(0, 1e6), st.booleans())
@settings(deadline=None)
def test_developing_takes_any_light_and_repeats(radiance, gray):
    field = np.full((24, 25, 3), radiance) * np.linspace(0, 1, 25)[:, None]
    first, second = (develop(field, LENS, QUIET, 1.0, gray, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (np.diff(first.astype(int)[:, :12], axis=1) >= 0).all()  # more light, more signal


def test_gray_is_the_luminance():
    red, white = np.zeros((24, 25, 3)), np.full((24, 25, 3), 0.2126)
    red[..., 0] = 1.0
    pictures = [develop(field, LENS, QUIET, 1.0, True, np.random.default_rng(0)).astype(int) for field in (red, white)]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


# The drive and the district


@pytest.mark.parametrize("route", ROUTES)
def test_drive_is_even_and_keeps_to_its_lane(route):
    drive = plan_drive(DISTRICT, route, 300)
    steps = np.diff(drive.points, axis=0)
    length = np.linalg.norm(steps, axis=1)
    assert length.max() / length.min() < 1.03  # chords of the turns are a little shorter
    along = np.stack([np.cos(drive.headings), np.sin(drive.headings)], -1)
    assert (np.sum(along[:-1] * steps, -1) / length > 0.95).all()
    crossing = 2 * HALF_STREET
    for point, heading in zip(drive.points, along, strict=True):
        axis = int(abs(heading[1]) > abs(heading[0]))  # 0: drives along x, so its lane is told by y
        if np.abs((DISTRICT.xs, DISTRICT.ys)[axis] - point[axis]).min() < crossing:
            continue
        lines = (DISTRICT.ys, DISTRICT.xs)[axis]
        centre_line = lines[np.abs(lines - point[1 - axis]).argmin()]
        right = np.array([heading[1], -heading[0]])[1 - axis]
        assert (point[1 - axis] - centre_line) * right == pytest.approx(LANE, abs=1e-6)


def pieces(route):
    """The street pieces between crossings that a route drives along, and the crossings it passes."""
    passed = []
    for (i, j), (k, m) in itertools.pairwise(ROUTES[route]):
        assert i == k or j == m
        count = max(abs(i - k), abs(j - m))
        passed += [(i + (k - i) * n // count, j + (m - j) * n // count) for n in range(count)]
    passed.append(ROUTES[route][-1])
    return [frozenset(piece) for piece in itertools.pairwise(passed)], set(passed)


def test_routes_share_neither_streets_nor_crossings():
    train, train_crossings = pieces("train")
    test, test_crossings = pieces("test")
    assert not set(train) & set(test) and not train_crossings & test_crossings
    assert len(set(train)) == len(train) and len(set(test)) == len(test)
    assert all(0 <= i < STREETS and 0 <= j < STREETS for i, j in train_crossings | test_crossings)


def test_train_and_test_stay_apart():
    train, test = (plan_drive(DISTRICT, route, 300).points for route in ("train", "test"))
    assert np.linalg.norm(train[:, None] - test, axis=-1).min() > 2 * HALF_STREET


@pytest.mark.parametrize("route", ROUTES)
def test_poses_of_the_drive(route):
    drive = plan_drive(DISTRICT, route, 60)
    for index in range(60):
        pose = drive.pose(index)
        np.testing.assert_array_equal(pose.t, drive.pose(index).t)
        np.testing.assert_allclose(pose.R @ pose.R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.R) == pytest.approx(1)
        assert pose.R[2, 1] < -np.cos(np.radians(5))  # the rig's y points to the ground
        forward = np.array([np.cos(drive.headings[index]), np.sin(drive.headings[index]), 0])
        assert pose.R[:, 2] @ forward > np.cos(np.radians(5))
        np.testing.assert_array_equal(pose.t[:2], drive.points[index])
        assert 1.8 < pose.t[2] < 2.0


@given(st.integers(0, 2**32))
@settings(max_examples=20, deadline=None)
def test_lots_fill_their_block_and_do_not_overlap(seed):
    district = plan_district(seed)
    for block in district.blocks:
        area, lots = block.building_line, split_lots(block, np.random.default_rng([seed, block.number]))
        assert not any(lot.empty for lot in lots if sum(lot.street_sides) > 1)
        assert sum(np.prod(lot.ground.size) for lot in lots) == pytest.approx(np.prod(area.size))
        for lot in lots:
            g = lot.ground
            assert area.x0 <= g.x0 + 1e-9 and g.x1 <= area.x1 + 1e-9
            assert area.y0 <= g.y0 + 1e-9 and g.y1 <= area.y1 + 1e-9
            assert all(opened or not street for opened, street in zip(lot.open_sides, lot.street_sides, strict=True))
        for a, b in itertools.combinations((lot.ground for lot in lots), 2):
            assert min(a.x1, b.x1) - max(a.x0, b.x0) < 1e-9 or min(a.y1, b.y1) - max(a.y0, b.y0) < 1e-9


def test_blocks_leave_room_for_the_streets():
    kerbs = [block.kerb for block in DISTRICT.blocks]
    assert len(kerbs) == (STREETS + 1) ** 2
    for a, b in itertools.combinations(kerbs, 2):
        gap = max(max(a.x0, b.x0) - min(a.x1, b.x1), max(a.y0, b.y0) - min(a.y1, b.y1))
        assert gap >= 2 * HALF_STREET - 1e-9


@pytest.mark.parametrize("frame", [1, 706, 981])
def test_traffic_neither_collides_nor_comes_near_the_rig(frame):
    cars = []

    def put(kind, at, yaw, paint):
        cars.append(SimpleNamespace(kind=kind))
        return cars[-1]

    traffic = Traffic(DISTRICT, SimpleNamespace(put=put))
    rig = plan_drive(DISTRICT, "test", 300).points[frame % 300]
    traffic.show(frame, rig)
    seen = [car for car in cars if not car.hide_render]
    assert len(seen) > 50
    at = np.array([car.location[:2] for car in seen])
    along_x = np.abs(np.cos([car.rotation_euler[2] for car in seen]))[:, None] > 0.5
    size = np.array([(BODIES[car.kind].length, BODIES[car.kind].width) for car in seen])
    half = np.where(along_x, size, size[:, ::-1]) / 2
    gap = (np.abs(at[:, None] - at) - half[:, None] - half).max(-1)
    assert gap[~np.eye(len(seen), dtype=bool)].min() > 0.1
    assert np.linalg.norm((np.abs(at - rig) - half).clip(0), axis=1).min() > 2.9


# Files: a frame is there whole or not at all


TINY = replace(SETS["sunny/test"], size=(25, 24), samples=1, truths=((16, 4), (24, 6)))


@pytest.fixture
def no_blender(monkeypatch):
    """The renderer with the part that needs Blender replaced by numbers that depend on the pose."""
    here = "render"
    blender = SimpleNamespace(empty_scene=lambda: None)
    city = SimpleNamespace(build_city=lambda seed: (plan_district(seed), SimpleNamespace(show=lambda *_: None)))
    lights = SimpleNamespace(add_light=lambda name: SimpleNamespace(exposure=1.0))
    for name, module in (("blender", blender), ("city", city), ("lights", lights)):
        monkeypatch.setitem(sys.modules, f"{here}.{name}", module)

    def render_frame(images, rig, T_world_rig, exposure, seed):
        rng = np.random.default_rng(np.abs(T_world_rig.t * 1e6).astype(int))
        pictures = [rng.integers(0, 255, (*images.size[::-1], 3), np.uint8) for _ in rig.cameras]
        return pictures, [rng.random(size[::-1]) for size in images.truths]

    monkeypatch.setattr(frames_module, "_render_frame", render_frame)


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_rendered_set_is_a_data_set(no_blender, tmp_path):
    assert list(render_set(tmp_path, TINY, (706, 731), SEED)) == [706, 731]
    data = osl.load_dataset(tmp_path)
    assert [frame.number for frame in data] == [706, 731]
    assert all(image.shape == (24, 25, 3) for frame in data for image in frame.images)
    assert [osl.load_dataset(tmp_path, gt_width=w)[0].inverse_depth.shape for w in (16, 24)] == [(4, 16), (6, 24)]
    assert list(render_set(tmp_path, TINY, (706, 731), SEED)) == []


@pytest.mark.parametrize("renames", range(6))
def test_killed_and_started_again_the_set_is_the_same(renames, no_blender, tmp_path, monkeypatch):
    whole, killed, numbers = tmp_path / "whole", tmp_path / "killed", (706, 731)
    list(render_set(whole, TINY, numbers, SEED))

    replacing, count = Path.replace, itertools.count()

    def kill(path, target):
        if "0731" in str(target) and next(count) == renames:
            raise KeyboardInterrupt
        return replacing(path, target)

    monkeypatch.setattr(Path, "replace", kill)
    with pytest.raises(KeyboardInterrupt):
        list(render_set(killed, TINY, numbers, SEED))
    monkeypatch.setattr(Path, "replace", replacing)
    assert is_complete(killed, TINY, 706) and not is_complete(killed, TINY, 731)
    finished = {path: content for path, content in contents(killed).items() if "706" in path.name}

    left = forget_partial(killed, TINY, numbers)
    assert len(left) == 6  # four pictures and two truths, renamed or not
    assert contents(killed) == {**finished, Path("config.yaml"): (killed / "config.yaml").read_bytes()}
    assert list(render_set(killed, TINY, numbers, SEED)) == [731]
    assert contents(killed) == contents(whole)


def test_steps_of_the_first_release_and_another_sets_truth(no_blender, tmp_path):
    train = replace(TINY, truth_suffix=".png")
    list(render_set(tmp_path / "train", train, (706,), SEED))
    list(render_set(tmp_path / "whole", TINY, (706,), SEED))
    steps, exact = (osl.load_dataset(tmp_path / name)[0].inverse_depth for name in ("train", "whole"))
    min_depth = osl.load_dataset(tmp_path / "train").rig.min_depth
    limited = np.minimum(exact, 1 / min_depth)  # what is nearer does not occur
    assert (np.abs(steps - limited) <= 2.5 / 65500 / min_depth + 2**-15 * exact).all()
    cloudy = replace(TINY, truths=(), truth_of="whole")
    list(render_set(tmp_path / "cloudy" / "test", cloudy, (706,), SEED))
    assert np.array_equal(osl.load_dataset(tmp_path / "cloudy" / "test")[0].inverse_depth, exact)


def test_room_and_its_rig_come_from_the_set(no_blender, tmp_path, monkeypatch):
    poses = [osl.Pose.from_vector([0, 0, 0, x, 0, 0]) for x in (1.0, 2.0)]
    room = SimpleNamespace(build_room=lambda light, seed: 1.0, room_pose=lambda index: poses[index])
    monkeypatch.setitem(sys.modules, "render.indoor", room)
    images = replace(SETS["indoor/test"], size=(25, 24), truths=((16, 4),))
    assert list(render_set(tmp_path, images, images.shipped, SEED)) == [1, 2]
    data = osl.load_dataset(tmp_path)
    assert data.rig.min_depth == make_rig(SEED, "handheld").min_depth
    for frame, pose in zip(data, poses, strict=True):  # the stand-in's noise follows the pose; JPEG keeps most of it
        rng = np.random.default_rng((pose.t * 1e6).astype(int))
        pictures = [rng.integers(0, 255, (24, 25, 3), np.uint8) for _ in range(4)]
        assert np.corrcoef(pictures[3].mean(-1).ravel(), frame.images[3].mean(-1).ravel())[0, 1] > 0.5


def test_forgetting_leaves_other_machines_and_files_alone(no_blender, tmp_path):
    list(render_set(tmp_path, TINY, (706,), SEED))
    (tmp_path / "cam1" / "0731.jpg").write_bytes(b"of a killed run")
    (tmp_path / "cam1" / ".0732.jpg").write_bytes(b"another machine is at it")
    (tmp_path / "cam1" / "notes.jpg").write_bytes(b"of somebody")
    before = contents(tmp_path)
    assert forget_partial(tmp_path, TINY, (706, 731)) == [tmp_path / "cam1" / "0731.jpg"]
    del before[Path("cam1/0731.jpg")]
    assert contents(tmp_path) == before


@given(st.lists(st.integers(1, 1000), unique=True, max_size=40), st.integers(1, 12))
@settings(deadline=None)
def test_shards_share_all_frames_out(numbers, parts):
    shards = [select_shard(tuple(numbers), f"{part}/{parts}") for part in range(1, parts + 1)]
    assert sorted(itertools.chain(*shards)) == sorted(numbers)
    assert max(map(len, shards)) - min(map(len, shards)) <= 1


@given(st.lists(st.floats(1e-9, 1e3), min_size=1))
@settings(deadline=None)
def test_truth_is_rounded_by_little(values):
    rounded = frames_module._rounded(np.array(values))
    assert rounded.dtype == np.float32
    np.testing.assert_allclose(rounded, values, rtol=2**-15)
    assert frames_module._rounded(np.zeros(1)) == 0


def test_manifest_lists_every_file_but_itself(tmp_path):
    (tmp_path / "set" / "cam1").mkdir(parents=True)
    (tmp_path / "set" / "cam1" / "0001.jpg").write_bytes(b"picture")
    (tmp_path / "set" / "cam1" / ".0002.jpg").write_bytes(b"half a picture")
    (tmp_path / "set" / ".0003").mkdir()
    (tmp_path / "set" / ".0003" / "0003.jpg").write_bytes(b"of half a frame")
    for _ in range(2):  # the second time there is one already
        write_manifest(tmp_path, 5, "python -m render")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["seed"] == 5 and manifest["command"] == "python -m render"
    assert manifest["files"] == {"set/cam1/0001.jpg": hashlib.sha256(b"picture").hexdigest()}
    (tmp_path / "weights").write_bytes(b"trained")
    renew_manifest(tmp_path)
    renewed = json.loads((tmp_path / "manifest.json").read_text())
    assert renewed == manifest | {"files": {**manifest["files"], "weights": hashlib.sha256(b"trained").hexdigest()}}


def test_sets_ship_frames_that_they_have():
    for name, images in SETS.items():
        last = images.first + images.count
        assert all(images.first <= number < last for number in images.shipped), name
        assert images.route in ROUTES or images.world == "room", name
        assert images.size[0] * 96 == images.size[1] * 100, name
    assert len(SETS["sunny/train"].shipped) >= 120
    assert all(len(SETS[f"{light}/test"].shipped) >= 8 for light in ("sunny", "cloudy", "sunset"))


# The command line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["moon/test"], ["moon/test", "sunny/train"]),
        (["sunny/test", "--frames", "700"], ["701 to 1000", "700"]),
        (["sunny/train", "--frames", "3", "701"], ["1 to 700", "701"]),
        (["rooms/train", "--frames", "81"], ["1 to 80", "81"]),
        (["--shard", "0/4"], ["i/n", "0/4"]),
        (["--shard", "5/4"], ["i/n"]),
        (["--shard", "half"], ["i/n", "half"]),
        (["--shard", "1/2/3"], ["i/n"]),
        (["--seed", "-1"], ["seed", "-1"]),
    ],
)
def test_bad_arguments_are_said_in_one_line(arguments, words, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert all(word in error for word in words)


def test_missing_environment_says_how_to_make_it(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(render, "_BLENDER_PYTHON", tmp_path / ".venv-render" / "bin" / "python")
    assert main(["--out", str(tmp_path)]) == 2
    assert "make render" in capsys.readouterr().err


def test_environment_without_blender_does_not_call_itself(monkeypatch, capsys):
    monkeypatch.setattr(render, "_BLENDER_PYTHON", Path(sys.prefix) / "bin" / Path(sys.executable).name)
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    assert main([]) == 2
    assert "unfinished" in capsys.readouterr().err


def test_blender_environment_gets_the_same_job(monkeypatch, tmp_path):
    python = tmp_path / ".venv-render" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.touch()
    calls = []
    monkeypatch.setattr(render, "_BLENDER_PYTHON", python)
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(
        render.subprocess, "run", lambda command, **_: calls.append(command) or SimpleNamespace(returncode=7)
    )
    monkeypatch.chdir(tmp_path)
    job = ["sunny/test", "--frames", "706", "831", "--shard", "2/2", "--seed", "3"]
    assert main([*job, "--out", "here"]) == 7  # the exit status is the renderer's
    assert [str(word) for word in calls[0]] == [
        str(python), "-m", "render", *job, "--out", str(tmp_path / "here")
    ]  # fmt: skip


def test_folder_that_cannot_be_written(no_blender, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(OmnistereoError, match="cannot be written to"):
        list(render_set(tmp_path / "file" / "test", TINY, (706,), SEED))


# The frames that ship

FRAMES = (0, -1)  # the first and the last of the set, hundreds of metres apart
GRID = osl.SphereGrid(640, 160, num_spheres=192, min_depth=1.65)
WINDOW = 5  # 2.8°, as 9 at the width of the paper


@pytest.fixture(scope="module")
def shipped():
    return osl.load_dataset(SAMPLES, split="test")


def test_shipped_rig_is_the_one_of_the_seed(shipped, tmp_path):
    write_config(tmp_path / "config.yaml", make_rig(SEED), SETS["sunny/test"].size, {"start": 701})
    made = osl.Rig.load(tmp_path)
    rays = directions(110)
    for old, new in zip(shipped.rig.cameras, made.cameras, strict=True):
        np.testing.assert_allclose(old.project(rays)[0], new.project(rays)[0], atol=1e-6)
    for old, new in zip(shipped.rig.T_rig_cam, made.T_rig_cam, strict=True):
        np.testing.assert_allclose(old.as_vector(), new.as_vector(), atol=1e-12)


def sample(panorama, pixels, how):
    """Look a panorama up at (column, row), around the seam."""
    maps = (pixels + np.array([8, 0])).astype(np.float32)
    return cv2.remap(np.pad(panorama, ((0, 0), (8, 8)), mode="wrap"), maps[..., 0], maps[..., 1], how)


def around(panorama, size):
    """The lowest and the highest value in the window around each pixel, around the seam."""
    wide = np.pad(panorama, ((0, 0), (size, size)), mode="wrap")
    window = np.ones((size, size), np.uint8)
    return tuple(find(wide, window)[:, size:-size] for find in (cv2.erode, cv2.dilate))


def all_around(mask, size=WINDOW):
    """Where a mask is true in the whole window around a pixel."""
    return around(mask.astype(np.uint8), size)[0] > 0


def means(picture, size=WINDOW):
    """The mean over the window around each pixel, around the seam."""
    return cv2.blur(np.pad(picture, ((0, 0), (size, size)), mode="wrap"), (size, size))[:, size:-size]


@pytest.mark.parametrize("i", FRAMES)
def test_truths_of_both_sizes_agree_where_depth_is_smooth(shipped, i):
    fine = shipped[i].inverse_depth
    coarse = osl.load_dataset(SAMPLES, split="test", gt_width=640)[i].inverse_depth
    pixels, _ = osl.SphereGrid(1200, 300).project(GRID.rays())
    low, high = (sample(values, pixels, cv2.INTER_NEAREST) for values in around(fine, 3))
    smooth = (low > 0) & (high < 1.05 * low)
    smooth[[0, -1]] = False
    assert smooth.mean() > 0.5
    coarse = coarse[smooth]
    difference = np.abs(sample(fine, pixels, cv2.INTER_LINEAR)[smooth] / coarse - 1)
    assert np.median(difference) < 5e-5 and np.quantile(difference, 0.9) < 2e-3
    # A pixel of the finer one beside it, and it is seen:
    beside = np.abs(sample(fine, pixels + np.array([0, 1]), cv2.INTER_LINEAR)[smooth] / coarse - 1)
    assert np.median(beside) > 1e-3


def test_shipped_truth_is_a_street(shipped):
    for frame in shipped:
        truth = frame.inverse_depth
        assert truth.shape == (300, 1200) and np.isfinite(truth).all()
        assert truth.max() <= 1 / shipped.rig.min_depth
        sky, near = (truth == 0), (truth > 1 / (3 * shipped.rig.min_depth))
        assert 0.02 < sky.mean() < 0.4 and near.mean() > 0.1
        assert not sky[150:].any()  # below the horizon there is ground


def test_shipped_pictures_are_neither_black_nor_burnt_out(shipped):
    for i, camera in itertools.product(FRAMES, range(4)):
        picture = shipped[i].images[camera]
        lens = shipped.rig.cameras[camera]
        grid = np.stack(np.meshgrid(*map(np.arange, lens.image_size)), -1)
        seen = picture[lens.unproject(grid)[1]]
        assert (seen.min(-1) >= 250).mean() < 0.02 and (seen.max(-1) < 8).mean() < 0.1
        assert 50 < seen.mean() < 160
        assert 0 < picture[:8, :8].mean() < 12  # outside the lens circle: the sensor's noise in the dark


def surely_seen(centre, inverse_depth):
    """Where a camera sees the point of a ray: the whole line of sight lies before what the rig's centre sees."""
    with np.errstate(divide="ignore"):
        points = GRID.rays() * np.minimum(1 / inverse_depth, 1e4)[..., None]
    seen = np.ones(GRID.shape, bool)
    for share_of_way in np.linspace(0.05, 0.995, 12):
        between = centre + share_of_way * (points - centre)
        pixels, inside = GRID.project(between)
        covered = np.linalg.norm(between, axis=-1) * sample(inverse_depth, pixels, cv2.INTER_NEAREST) > 1.02
        seen &= inside & ~covered
    return seen


def warped_zncc(shipped, frame, inverse_depth):
    """ZNCC and contrast in windows of neighbouring cameras' images, warped with a depth for each ray."""
    sweep = osl.SphereSweep(shipped.rig, GRID)
    gray = [image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in frame.images]
    gray = [image.astype(np.float32) for image in gray]
    warped = sweep.warp(gray, GRID.inverse_depth_to_index(inverse_depth))
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        both = np.isfinite(warped[a]) & np.isfinite(warped[b])
        A, B = (np.where(both, image, 0) for image in (warped[a], warped[b]))
        spread = [means(image * image) - means(image) ** 2 for image in (A, B)]
        covariance = means(A * B) - means(A) * means(B)
        with np.errstate(invalid="ignore", divide="ignore"):
            zncc = covariance / np.sqrt(spread[0] * spread[1])
        yield (a, b), np.where(all_around(both), zncc, np.nan), np.sqrt(np.minimum(*spread).clip(0))


@pytest.mark.parametrize("i", FRAMES)
def test_images_warped_with_the_truth_agree(shipped, i):
    """The sensors' noise reaches 7 gray values in shadows: texture is what has three times that contrast."""
    frame = osl.load_dataset(SAMPLES, split="test", gt_width=640)[i]
    truth = frame.inverse_depth
    low, high = around(truth, WINDOW)
    smooth = (low > 0) & (high < 1.15 * low)
    seen = [surely_seen(centre, truth) for centre in shipped.rig.centers]
    wrong = warped_zncc(shipped, frame, truth * 1.2)
    for ((a, b), zncc, contrast), (_, off, _) in zip(warped_zncc(shipped, frame, truth), wrong, strict=True):
        textured = smooth & all_around(seen[a] & seen[b]) & np.isfinite(zncc) & (contrast > 20)
        assert textured.sum() > 300
        assert np.median(zncc[textured]) > 0.95 and (zncc[textured] > 0.9).mean() > 0.9
        assert (off[textured] > 0.9).mean() < 0.7 * (zncc[textured] > 0.9).mean()  # but less with a wrong depth


# The sets beside the street's: from the air, and in a room

OTHERS = {
    "aerial": osl.SphereGrid(640, 320, (-90, 90), num_spheres=192, min_depth=1.65),
    "indoor": osl.SphereGrid(640, 160, num_spheres=192, min_depth=0.55),
}


def test_aerial_truth_is_the_full_sphere_of_a_tilted_rig_above_a_street():
    data, images = osl.load_dataset(SAMPLES.parent / "aerial", split="test"), SETS["aerial/test"]
    drive = plan_drive(DISTRICT, images.route, images.count)
    for frame in data:
        T_world_rig = drive.pose(frame.number - images.first) @ osl.Pose.from_vector(images.T_drive_rig)
        tilt = np.degrees(np.arccos(-T_world_rig.R[2, 1]))  # between the rig's down and the world's
        assert 12 < tilt < 18 and 15 < T_world_rig.t[2] < 20
        grid = osl.SphereGrid(1200, 600, (-90, 90))
        truth = frame.inverse_depth
        assert truth.shape == grid.shape and np.isfinite(frame.gt_index(OTHERS["aerial"])).all()
        rays = grid.rays() @ T_world_rig.R.T
        assert (truth[rays[..., 2] < -0.05] > 0).all() and (truth[rays[..., 2] > 0.99] == 0).all()
        height = (T_world_rig.t + rays[truth > 0] / truth[truth > 0, None])[:, 2]
        below = -rays[truth > 0, 2] > 0.9
        assert np.abs(height[below]).min() < 1e-3 and height.min() > -0.1  # the file's steps: 4 cm at 100 m
        assert (np.abs(height[below]) < 0.2).mean() > 0.4  # carriageway and pavement; the rest stands on them


def test_indoor_truth_is_a_room_that_leaves_place_for_the_rig():
    data = osl.load_dataset(SAMPLES.parent / "indoor", split="test")
    assert data.rig.min_depth == 0.55
    for frame in data:
        truth = frame.inverse_depth
        assert truth.shape == (300, 1200) and truth.max() < 1 / 0.55
        assert (truth > 1 / 6.5).mean() > 0.9 and (truth[-1] > 1 / 3).all()  # all but the window; the floor
    first, second = (frame.inverse_depth for frame in data)
    assert np.median(np.abs(first - second) / np.maximum(first, second)) > 0.1  # two places


@pytest.mark.parametrize("name", OTHERS)
def test_other_sets_images_warped_with_the_truth_agree(name, monkeypatch):
    """Only on single surfaces: with shelves this close, two depths in a window do not fit one warp."""
    monkeypatch.setattr(sys.modules[__name__], "GRID", OTHERS[name])
    data = osl.load_dataset(SAMPLES.parent / name, split="test", gt_width=640)
    truth = data[0].inverse_depth
    low, high = around(truth, WINDOW)
    smooth = (low > 0) & (high < 1.02 * low)
    seen = [surely_seen(centre, truth) for centre in data.rig.centers]
    wrong = warped_zncc(data, data[0], truth * 1.2)
    for ((a, b), zncc, contrast), (_, off, _) in zip(warped_zncc(data, data[0], truth), wrong, strict=True):
        textured = smooth & all_around(seen[a] & seen[b]) & np.isfinite(zncc) & (contrast > 20)
        assert textured.sum() > 300
        assert np.median(zncc[textured]) > 0.95 and (zncc[textured] > 0.9).mean() > 0.95
        assert (off[textured] > 0.9).mean() < 0.5 * (zncc[textured] > 0.9).mean()


# The street in other lights, and the streets that training sees


@pytest.mark.parametrize("light", ["cloudy", "sunset"])
def test_other_lights_show_the_same_street(light):
    sunny = osl.load_dataset(SAMPLES, split="test", gt_width=640)
    data = osl.load_dataset(SAMPLES.parent / light, split="test", gt_width=640)
    assert [frame.number for frame in data] == [frame.number for frame in sunny]
    assert [frame.gt_path.resolve() for frame in data] == [frame.gt_path.resolve() for frame in sunny]
    for old, new in zip(sunny.rig.T_rig_cam, data.rig.T_rig_cam, strict=True):
        np.testing.assert_array_equal(old.as_vector(), new.as_vector())
    warmth = sky_warmth(data) / sky_warmth(sunny)
    # Blue under the sun, gray under clouds, in between with the evening's red in it.
    assert 1.3 < warmth < 1.5 if light == "cloudy" else 1.15 < warmth < 1.3


def sky_warmth(data):
    """Red by blue of the sky, the mean over a set."""
    sweep = osl.SphereSweep(data.rig, osl.SphereGrid(640, 160, num_spheres=2, min_depth=1.65))
    ratios = []
    for frame in data:
        red, blue = (
            np.nanmean(sweep.warp([image[..., k].astype(np.float32) for image in frame.images], 0), axis=0)
            for k in (0, 2)
        )
        ratios.append((red / (blue + 1))[frame.inverse_depth == 0])
    return np.concatenate(ratios).mean()


@pytest.mark.parametrize("name", ["cloudy/test", "sunset/test", "sunny/train"])
def test_pictures_of_other_lights_and_streets_are_neither_black_nor_burnt_out(name):
    data = osl.load_dataset(SAMPLES.parent / name)
    black = []
    for i, camera in itertools.product(range(0, len(data), max(1, len(data) // 8)), range(4)):
        picture = data[i].images[camera].reshape(*data[i].images[camera].shape[:2], -1)
        lens = data.rig.cameras[camera]
        grid = np.stack(np.meshgrid(*map(np.arange, lens.image_size)), -1)
        seen = picture[lens.unproject(grid)[1]]
        black.append((seen.max(-1) < 8).mean())
        assert (seen.min(-1) >= 250).mean() < 0.05 and black[-1] < 0.25  # a street's side in the shade
        assert 35 < seen.mean() < 160
    assert np.mean(black) < 0.08


@pytest.mark.parametrize("name", ["cloudy/test", "sunset/test", "sunny/train"])
def test_warped_images_agree_in_other_lights_and_streets(name):
    data = osl.load_dataset(SAMPLES.parent / name, gt_width=640)
    frame = data[len(data) // 2]
    truth = frame.inverse_depth
    low, high = around(truth, WINDOW)
    smooth = (low > 0) & (high < 1.1 * low)
    seen = [surely_seen(centre, truth) for centre in data.rig.centers]
    wrong = warped_zncc(data, frame, truth * 1.2)
    right, off = [], []
    for ((a, b), zncc, contrast), (_, other, _) in zip(warped_zncc(data, frame, truth), wrong, strict=True):
        textured = smooth & all_around(seen[a] & seen[b]) & np.isfinite(zncc) & (contrast > 20)
        right.append(zncc[textured])
        off.append(other[textured])
    right, off = np.concatenate(right), np.concatenate(off)
    assert len(right) > 1000
    assert np.median(right) > 0.95 and (right > 0.9).mean() > 0.9
    assert (off > 0.9).mean() < 0.7 * (right > 0.9).mean()


def test_training_frames_are_those_of_the_drive():
    data, images = osl.load_dataset(SAMPLES, split="train"), SETS["sunny/train"]
    assert tuple(frame.number for frame in data) == images.shipped and len(data) >= 120
    near, sky = [], []
    for frame in data[::10]:
        assert all(image.shape == (384, 400) for image in frame.images)
        truth = frame.inverse_depth
        assert truth.shape == (160, 640) and np.isfinite(truth).all() and truth.max() <= 1 / data.rig.min_depth
        near.append(np.mean(truth > 1 / (3 * data.rig.min_depth)))
        sky.append(np.mean(truth == 0))
    assert np.mean(near) > 0.1 and 0.02 < np.mean(sky) < 0.4


# With Blender

BLENDER = render._BLENDER_PYTHON
needs_blender = pytest.mark.skipif(
    not list(BLENDER.parents[1].glob("lib/python*/site-packages/bpy")),
    reason="Blender's environment is not there: make render",
)


def in_blender(script, *arguments):
    """Run a script in Blender's interpreter, in the repository's root."""
    command = [BLENDER, "-c", script, *map(str, arguments)]
    done = subprocess.run(command, cwd=BLENDER.parents[2], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]


ONE_FRAME = """
import sys
from dataclasses import replace
import bpy, numpy as np
from mathutils import Vector
from render import main
from render import SEED, SETS
from render.drive import plan_drive
from render.layout import plan_district
from omnistereo_lib.geometry.sphere import SphereGrid

out = sys.argv[1]
SETS["sunny/test"] = replace(SETS["sunny/test"], size=(50, 48), samples=1, truths=((64, 16),))
assert main(["sunny/test", "--frames", "831", "--out", out]) == 0

# The scene is still there: ask it where the rays end, and where rays a hundred-thousandth of a radian beside them do.
T_world_rig = plan_drive(plan_district(SEED), "test", 300).pose(831 - 701)
chosen = np.random.default_rng(0).choice(64 * 16, 1000, replace=False)
rays = SphereGrid(64, 16).rays().reshape(-1, 3)[chosen] @ T_world_rig.R.T
beside = 1e-5 * np.array([(0, 0, 0), *np.eye(3), *-np.eye(3)])
depsgraph, origin = bpy.context.evaluated_depsgraph_get(), Vector(T_world_rig.t)
distances = np.full((1000, 7), np.inf)
for i, ray in enumerate(rays):
    for j, offset in enumerate(beside):
        hit, where, *_ = bpy.context.scene.ray_cast(depsgraph, origin, Vector(ray + offset))
        distances[i, j] = (where - origin).length if hit else np.inf
np.savez(out + "/cast.npz", chosen=chosen, distances=distances)
"""


@needs_blender
def test_one_frame_with_blender(tmp_path):
    in_blender(ONE_FRAME, tmp_path)
    assert set(json.loads((tmp_path / "manifest.json").read_text())["files"]) == {
        "sunny/test/config.yaml",
        "sunny/test/omnidepth_gt_64/00831.tiff",
        *(f"sunny/test/cam{camera}/0831.jpg" for camera in (1, 2, 3, 4)),
    }
    data = osl.load_dataset(tmp_path / "sunny", split="test")
    assert len(data) == 1 and data[0].number == 831
    assert all(image.shape == (48, 50, 3) and 30 < image.mean() < 200 for image in data[0].images)
    truth = data[0].inverse_depth.astype(np.float64)
    assert truth.shape == (16, 64) and 0.02 < (truth == 0).mean() < 0.4

    cast = np.load(tmp_path / "cast.npz")
    expected = 1 / cast["distances"]  # a ray along an edge may end on either side of it: one of seven will do
    error = np.abs(truth.ravel()[cast["chosen"], None] - expected) / np.where(expected > 0, expected, 1e-6)
    assert error.min(axis=1).max() < 1e-4 + 2**-15  # the file's rounding
    assert (error[:, 0] < 1e-4 + 2**-15).mean() > 0.98
    # The same picture as the one that ships, seen small.
    shipped = osl.load_dataset(SAMPLES, split="test")
    shipped = next(frame for frame in shipped if frame.number == 831)
    for small, large in zip(data[0].images, shipped.images, strict=True):
        large = cv2.resize(large, (50, 48), interpolation=cv2.INTER_AREA)
        assert np.corrcoef(small.ravel(), large.ravel())[0, 1] > 0.95


BALLS = """
import sys
import bpy, numpy as np
from omnistereo_lib.geometry.pose import Pose
from render.blender import empty_scene, fisheye_picture
from render.lens import Lens
from render.rig import make_rig

out, rays = sys.argv[1], np.load(sys.argv[1] + "/rays.npy")
empty_scene()
glow = bpy.data.materials.new("glow")
glow.use_nodes = True
glow.node_tree.nodes.clear()
emission, output = (glow.node_tree.nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "OutputMaterial"))
glow.node_tree.links.new(emission.outputs[0], output.inputs[0])
T_world_cam = Pose.from_vector([0.7, -0.4, 1.1, 3.0, -2.0, 1.5])
for ray in rays:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.5, location=T_world_cam @ (10 * ray))
    bpy.context.object.data.materials.append(glow)
lens = Lens(make_rig(5).cameras[0].lens.k, (419.5, 359.5))
np.save(out + "/picture.npy", fisheye_picture(lens, T_world_cam, (200, 192), 128, 0))
"""


@needs_blender
def test_balls_are_where_the_camera_model_says(tmp_path):
    """The whole chain of lens, shift, pose and row order; the axis is far from the middle, so that a shift shows."""
    theta = np.radians([0, 25, 25, 25, 50, 50, 50, 75, 75, 75, 90, 90, 90, 104, 104, 104])
    azimuth = np.arange(len(theta)) * np.radians(130)
    rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], -1)
    np.save(tmp_path / "rays.npy", rays)
    in_blender(BALLS, tmp_path)
    picture = np.load(tmp_path / "picture.npy").mean(-1)

    lens = replace(make_rig(5).cameras[0].lens, centre=(419.5, 359.5))
    fit = fit_ocam(lens, 200)
    camera = osl.OcamCamera(fit.poly, fit.inv_poly, fit.centre, (1, 0, 0), (200, 192))
    columns, rows = np.meshgrid(np.arange(200), np.arange(192))
    for (u, v), valid in zip(*camera.project(rays), strict=True):
        assert valid
        light = picture * (np.hypot(columns - u, rows - v) < 7)
        found = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
        assert np.abs(found - (u, v)).max() < 0.1
    blender_uv = blender_pixel(lens, rays, (200, 192))
    np.testing.assert_allclose(camera.project(rays)[0], blender_uv, atol=0.01)
