"""Training worlds without Blender: rigs and plans differ, frames are whole or absent."""

import sys
import warnings
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from render_stand_in import contents

import omnistereo_lib as osl
from workshop.render.camera.render_rig import random_rig, write_config
from workshop.render.image_sets import SEED, SETS
from workshop.render.indoor.rooms import plan_room, wall_frame
from workshop.render.surfaces.mesh_builder import Mesh
from workshop.render.things.scenes import plan_things
from workshop.render.things.shapes import SHAPES
from workshop.render.worlds import WORLDS, is_rendered, render_worlds

SIZE = (350, 336)


def rng(seed, *more):
    return np.random.default_rng([seed, *more])


def centers(rig):
    return np.array([camera.T_rig_cam.t for camera in rig.cameras])


def points_on(mesh, count=12):
    """Random points on all faces of a mesh, and their corners."""
    random = rng(0)
    parts = []
    for corners, _, _ in mesh._faces:
        weights = random.dirichlet(np.ones(corners.shape[1]), count)
        parts += [corners.reshape(-1, 3), np.einsum("kc,fcx->fkx", weights, corners).reshape(-1, 3)]
    return np.concatenate(parts)


def rotation(x, y, z):
    """Blender's XYZ Euler angles: about x first."""
    turns = np.diag((x, y, z))
    about = [osl.Pose.from_vector([*turn, 0, 0, 0]).R for turn in turns]
    return about[2] @ about[1] @ about[0]


# Rigs


def test_rigs_differ_and_stay_within_their_limits():
    rigs = [random_rig(rng(k), 0.3 * 10 ** (k / 100)) for k in range(101)]
    assert set(Counter(len(rig.cameras) for rig in rigs)) == {3, 4, 5, 6}
    for rig in rigs:
        at = centers(rig)
        np.testing.assert_allclose(at.mean(axis=0), 0, atol=1e-12)
        assert np.linalg.norm(at, axis=1).max() < 0.6 * rig.min_depth  # nothing is inside the rig
        baselines = np.linalg.norm(at - np.roll(at, 1, axis=0), axis=1)
        assert baselines.min() > 0.045 and baselines.max() < 1.5
        assert all(180 <= camera.lens.max_fov_deg <= 220 for camera in rig.cameras)
        axes = np.array([camera.T_rig_cam.R[:, 2] for camera in rig.cameras])
        assert np.abs(axes[:, 1]).max() < np.sin(np.radians(20))  # they look around, not up or down
    heights = [np.ptp(centers(rig)[:, 1]) / rig.min_depth for rig in rigs]
    # some have cameras above and below their plane
    assert 10 < sum(height > 0.05 for height in heights) < 60


def test_two_cameras_of_a_rig_see_nearly_every_direction():
    grid = osl.SphereGrid(64, 16)
    for k in range(12):
        seen = np.zeros(grid.shape, int)
        for camera in random_rig(rng(k), 1.0).cameras:
            cosine = grid.rays() @ camera.T_rig_cam.R[:, 2]
            seen += cosine > np.cos(np.radians(camera.lens.max_fov_deg / 2))
        assert seen.min() >= 1 and (seen >= 2).mean() > 0.6


@pytest.mark.parametrize("seed", range(2))
def test_written_rig_has_the_angles_of_its_lenses(seed, tmp_path):
    rig = random_rig(rng(seed), 0.8)
    write_config(tmp_path / "config.yaml", rig, SIZE, {"start": 1}, digits=12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = osl.load_rig(tmp_path)
    assert loaded.min_depth == rig.min_depth
    for camera, pose, made in zip(loaded.cameras, loaded.T_rig_cam, rig.cameras, strict=True):
        np.testing.assert_allclose(pose.R, made.T_rig_cam.R, atol=1e-12)
        assert camera.max_fov_deg == made.lens.max_fov_deg and camera.inverse_poly_error_px() < 5e-3
        radius = np.arange(10.0, 160.0, 10.0)
        u, v = camera.center
        rays, _ = camera.unproject(np.column_stack([u + radius, 0 * radius + v]))
        angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
        np.testing.assert_allclose(angle, made.lens.theta(radius * 800 / 350), atol=1e-4)


# Plans


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_lie_in_the_unit_sphere(name):
    for k in range(10):
        mesh = Mesh()
        SHAPES[name](mesh, rng(k), ["a", "b", "c"])
        assert np.linalg.norm(points_on(mesh, 2), axis=1).max() <= 1 + 1e-9


def tilt_deg(pose):
    return np.degrees(np.arccos(-pose.R[2, 1]))  # of the y axis of the rig against the vertical


@pytest.mark.parametrize("seed", range(4))
def test_no_thing_is_nearer_than_the_rig_is_made_for(seed):
    plan = plan_things(rng(seed))
    assert 0.4 <= plan.min_depth <= 3 and tilt_deg(plan.T_world_rig) <= 15 + 1e-6
    assert plan.ground is None or -plan.ground >= plan.min_depth
    assert plan.backdrop in ("sky", "plain") or plan.extent.min() > plan.min_depth
    nearest = []
    for thing in plan.things:
        points = thing.scale * points_on(thing.mesh, 3) @ rotation(*thing.angles).T + thing.at
        nearest.append(np.linalg.norm(points, axis=1).min())
        assert plan.ground is None or points[:, 2].min() > plan.ground - 1e-6
    assert min(nearest) >= plan.min_depth and len(nearest) > 15
    assert max(nearest) / min(nearest) > 3


@pytest.mark.parametrize("seed", range(4))
def test_rooms_hold_their_furniture_and_leave_place_for_the_rig(seed):
    plan = plan_room(rng(seed))
    at = plan.T_world_rig.t
    assert min(*at, *(plan.size - at)) > plan.min_depth and tilt_deg(plan.T_world_rig) <= 15 + 1e-6
    for piece in plan.pieces:
        points = piece.scale * points_on(piece.mesh, 3) @ rotation(0, 0, piece.yaw).T + piece.at
        assert (points > -0.02).all() and (points < plan.size + 0.02).all()
        assert np.linalg.norm(points - at, axis=1).min() >= plan.min_depth
    for window in plan.windows:
        length = wall_frame(plan.size, window.side)[3]
        assert 0 < window.start < window.end < length
        assert 0 < window.sill < window.top < plan.size[2]
        others = [w for w in plan.windows if w.side == window.side and w is not window]
        assert all(w.end <= window.start or w.start >= window.end for w in others)


def test_plans_come_from_their_seeds():
    for plan, describe in (
        (
            plan_things,
            lambda p: (p.min_depth, len(p.things), *p.extent, *p.T_world_rig.as_vector()),
        ),
        (plan_room, lambda p: (p.min_depth, len(p.pieces), *p.size, *p.T_world_rig.as_vector())),
    ):
        first, again, other = (describe(plan(rng(seed))) for seed in (3, 3, 4))
        assert first == again and first != other


# Files


@pytest.fixture
def no_blender(monkeypatch):
    """For Blender noise and a ball of 2 m around the rig; one plain room for all frames."""
    blender = SimpleNamespace(
        empty_scene=lambda: None,
        fisheye_picture=lambda lens, pose, size, samples, seed: rng(seed).random((*size[::-1], 3)),
        depth_panorama=lambda pose, size, phi_deg: np.full(size[::-1], 2.0),
    )
    monkeypatch.setitem(sys.modules, "workshop.render.blender", blender)
    interiors = SimpleNamespace(build_room=lambda plan, rng: None)
    monkeypatch.setitem(sys.modules, "workshop.render.indoor.interiors", interiors)


TINY = replace(WORLDS["rooms/train"], size=(25, 24), truth=(20, 8))


def test_rendered_worlds_are_a_data_set(no_blender, tmp_path):
    assert list(render_worlds(tmp_path, TINY, (1, 2, 5), SEED)) == [1, 2, 5]
    data = osl.load_dataset(tmp_path)
    assert [frame.number for frame in data] == [1, 2, 5]
    for frame in data:
        assert len(frame.images) == len(frame.rig) and frame.images[0].shape == (24, 25)
        assert frame.inverse_depth.shape == (8, 20)
        expected = min(0.5, 1 / frame.rig.min_depth)
        assert np.abs(frame.inverse_depth - expected).max() <= 16.5 / 65500 / frame.rig.min_depth
    assert len({frame.rig.min_depth for frame in data}) == 3


def test_a_killed_frame_is_rendered_again_and_the_same(no_blender, tmp_path, monkeypatch):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    list(render_worlds(whole, TINY, (1, 2), SEED))

    def kill(*_):
        raise KeyboardInterrupt

    frames = render_worlds(killed, TINY, (1, 2), SEED)
    assert next(frames) == 1
    with monkeypatch.context() as patch:
        patch.setattr("workshop.render.worlds.write_frame", kill)
        with pytest.raises(KeyboardInterrupt):
            next(frames)
    assert is_rendered(killed, 1) and not is_rendered(killed, 2) and (killed / ".0002").is_dir()
    assert list(render_worlds(killed, TINY, (1, 2), SEED)) == [2]
    assert contents(killed) == contents(whole)


def test_worlds_and_sets_have_different_names_and_sizes_that_lenses_fit():
    assert not set(WORLDS) & set(SETS)
    for worlds in WORLDS.values():
        assert worlds.size[0] * 96 == worlds.size[1] * 100
        assert 180 * worlds.truth[1] / worlds.truth[0] >= 55  # ±45° and room for a tilt of 10°
    # seeds follow from numbers: no test frame is a training frame
    for world in ("things", "rooms"):
        assert not set(WORLDS[f"{world}/train"].shipped) & set(WORLDS[f"{world}/test"].shipped)
