"""Looks at a rig whose noise is known: how often a turn is found, or a false one."""

import json
import re

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_rigs.boards.bundle import cross
from omnistereo_rigs.images.track_bundle import by_moving, moved_rig, pose_differences
from omnistereo_rigs.images.watch import REFERENCE, Look, Watch, who_turned
from omnistereo_tools.record.watching import WATCH, Watching

RIG = scene.rig(width=400, height=384)
SEQUENCES, LOOKS = 25, 12


def seen(differences):
    return pose_differences(moved_rig(RIG, differences.reshape(-1, 6)), RIG).ravel()


# 24 numbers of poses, 17 show
SEEN = np.stack([seen(np.eye(24)[k] * 1e-6) / 1e-6 for k in range(24)], axis=1)


def noise(rng, turn_deg=0.02, shift=0.001):
    """The differences of a rig whose poses are off by chance, and their covariance."""
    sd = np.tile(np.repeat([np.radians(turn_deg), shift], 3), len(RIG))
    return (SEEN @ (sd * rng.normal(size=24))).reshape(-1, 6), SEEN @ np.diag(sd**2) @ SEEN.T


def watched(seed, degrees, lens_noise=1.0):
    """A watch of a rig whose third camera turns after the fifth look, and what it says."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    turned = np.zeros((len(RIG), 6))
    turned[2, :3] = np.radians(degrees) * axis / np.linalg.norm(axis)
    watch, said = Watch(RIG), []
    for number in range(LOOKS):
        differences, covariance = noise(rng)
        differences = lens_noise * differences + (
            seen(turned).reshape(-1, 6) if number >= LOOKS // 2 else 0.0
        )
        said.append(watch.add(Look(10 * number, differences, covariance)))
    return watch, list(filter(None, said)), turned


def test_a_turn_is_found_where_it_is_and_as_large_as_it_is():
    for seed in range(SEQUENCES):
        watch, said, turned = watched(seed, 0.25)
        assert len(said) == 1 and "camera 3 has turned" in said[0], f"{seed}: {said}"
        angle, deviation = map(float, re.findall(r"([\d.]+)°", said[0]))
        assert abs(angle - 0.25) < 4 * deviation + 0.01 and deviation < 0.04
        left = pose_differences(watch.rig_now(), moved_rig(RIG, turned))
        assert np.degrees(np.linalg.norm(left[2, :3])) < 0.08


@pytest.mark.parametrize("lens_noise", [1.0, 5.0])
def test_a_rig_that_stays_gives_no_alarm_even_where_lenses_contradict_each_other(lens_noise):
    assert sum(len(watched(seed, 0.0, lens_noise)[1]) for seed in range(SEQUENCES)) <= 1


def test_what_a_turn_of_one_camera_changes():
    """The rig as a whole turns by a quarter of it, which the differences leave out."""
    for camera in range(len(RIG)):
        J = np.zeros((len(RIG), 6, 3))
        J[:, :3] = -np.eye(3) / len(RIG)
        J[camera, :3] += np.eye(3)
        J[:, 3:] = cross(RIG.centers - RIG.centers.mean(axis=0)) / len(RIG)
        np.testing.assert_allclose(by_moving(RIG, camera)[:, :3], J.reshape(-1, 3), atol=1e-4)


def test_the_chance_of_a_look_is_what_it_says():
    rng = np.random.default_rng(0)
    p_values = [who_turned(RIG, *noise(rng)).p_value for _ in range(300)]
    assert 0.0 < np.mean(np.array(p_values) < 0.05) < 0.06  # four cameras: at most 5 of 100


def test_a_warning_needs_the_first_looks_and_two_more():
    watch, said, _ = watched(0, 0.25)
    assert len(watch.looks) == LOOKS and REFERENCE < LOOKS // 2
    assert said[0].endswith("where it looks")
    assert "since about frame 60: depth at 10 m is off by about " in said[0]


TURNED = np.zeros((4, 6))
TURNED[1, :3] = np.radians([0.3, 0.0, 0.4])


def looks():
    rng = np.random.default_rng(0)
    for number in range(REFERENCE + 2):
        differences, covariance = noise(rng, 0.01)
        moved = seen(TURNED).reshape(-1, 6) if number >= REFERENCE else 0.0
        yield Look(100 * number, differences + moved, covariance)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The folder of a recording, whose second camera turned, and its sweep before and after."""
    folder = tmp_path_factory.mktemp("recording")
    sweep = osl.SphereSweep(RIG, osl.SphereGrid(32, 8, num_spheres=4, min_depth=1.0))
    watching = Watching(RIG, sweep, follow=True, folder=folder)
    for look in looks():
        watching._say(look)
    watching.close()
    return folder, sweep, watching.sweep_at(100 * REFERENCE + 100)


def test_the_sweep_follows_the_camera_that_has_turned(recorded):
    folder, before, after = recorded
    turn = pose_differences(after.rig, moved_rig(before.rig, TURNED))[1, :3]
    assert np.degrees(np.linalg.norm(turn)) < 0.05
    written = osl.load_rig(next(folder.glob("rig_*.yaml")))
    np.testing.assert_allclose(written.T_rig_cam[1].R, after.rig.T_rig_cam[1].R, atol=1e-6)


def test_a_recording_that_goes_on_knows_what_was_seen(recorded):
    folder, before, after = recorded
    again = Watching(RIG, before, follow=True, folder=folder)
    np.testing.assert_array_equal(again.sweep_at(9999).rig.T_rig_cam[1].R, after.rig.T_rig_cam[1].R)
    assert again.sweep_at(0) is before  # a frame before the turn
    assert Watching(RIG, before, folder=folder).sweep_at(9999) is before
    assert (folder / "watch.png").stat().st_size > 5000


@pytest.mark.parametrize("text", ["", "[[1, 2]]", "{}", "[[0, [[1]], [[1]]]]", "[" * 9999])
def test_what_is_damaged_is_looked_at_anew(recorded, tmp_path, text):
    (tmp_path / WATCH).write_text(text)
    assert not Watching(RIG, recorded[1], folder=tmp_path).watch.looks
    rows = json.loads((recorded[0] / WATCH).read_text())
    assert len(rows) == REFERENCE + 2
