"""Other people's rigs: whatever the cameras, the walls are found."""

import numpy as np
import pytest
import scene

import omnistereo_lib as osl

GRID = osl.SphereGrid(160, 40, (-45, 45), 32, 0.9)
UP, DOWN = [np.pi / 2, 0, 0], [-np.pi / 2, 0, 0]


def rig_of(*cameras):
    """A rig of (axis-angle, place, lens) triples."""
    poses = [osl.Pose.from_vector([*turn, *place]) for turn, place, _ in cameras]
    return osl.Rig([lens for *_, lens in cameras], poses)


def ring(count, radius, lens):
    angles = 2 * np.pi * np.arange(count) / count
    return rig_of(*(([0, a, 0], [radius * np.sin(a), 0, radius * np.cos(a)], lens) for a in angles))


WIDE, NARROW, SMALL = scene.camera(400, 384), scene.camera(480, 400, 185.0), scene.camera(240, 232)
RIGS = {
    "a pair that looks ahead": rig_of(
        ([0, 0, 0], [-0.15, 0, 0], NARROW), ([0, 0, 0], [0.15, 0, 0], NARROW)
    ),
    "one up, one down": rig_of((UP, [0, -0.2, 0], WIDE), (DOWN, [0, 0.2, 0], WIDE)),
    "a ring of eight": ring(8, 0.3, NARROW),
    "three of mixed lenses and sizes": rig_of(
        ([0, 0, 0], [0, 0.05, 0.3], WIDE),
        ([0, 2.1, 0], [0.26, 0, -0.15], NARROW),
        ([0, 4.2, 0], [-0.26, 0, -0.15], SMALL),
    ),
}


@pytest.mark.parametrize("method", ["zncc+sgm", "volumenet"])
@pytest.mark.parametrize("name", RIGS)
def test_the_walls_are_found(name, method):
    rig = RIGS[name]
    depth = osl.estimate_depth(osl.Frame.of(rig, scene.images(rig, finest=0.12)), GRID, method)
    sweep = osl.SphereSweep(rig, GRID)
    truth = scene.true_index(rig, GRID)
    seen = (
        np.sum([sweep.project_sphere(camera, truth)[1] for camera in range(len(rig))], axis=0) >= 2
    )
    error = 100 / GRID.num_spheres * np.abs(depth.index - truth)[seen]
    assert seen.mean() > 0.3 and not np.isnan(error).any()
    # % of the spheres; one sphere is 3.1. VolumeNet has lost some of its feel for this pair since
    # rooms count twice.
    limit = 4 if (name, method) == ("one up, one down", "volumenet") else 3
    assert np.median(error) < 1.5 and np.mean(error) < limit
