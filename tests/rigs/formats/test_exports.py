"""Files for other programs."""

import numpy as np
import scene

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.output.frame import equirectangular_depth


def test_equirectangular_depth_covers_the_sphere():
    rig = scene.rig(width=200, height=192)
    grid = osl.SphereGrid(160, 60, (-30.0, 60.0), num_spheres=64, min_depth=0.6)
    index = scene.true_index(rig, grid).astype(np.float32)
    panorama = equirectangular_depth(osl.Depth(index, np.ones_like(index), SphereSweep(rig, grid)))
    assert panorama.shape == (80, 160) and panorama.dtype == np.float32
    phi = (np.arange(80) + 0.5) / 80 * 180 - 90
    unknown = np.isnan(panorama).all(1)
    np.testing.assert_array_equal(unknown, (phi < -30) | (phi > 60))
    center = np.mean([pose.t for pose in rig.T_rig_cam], 0)
    truth = scene.distance(center, osl.SphereGrid(160, 80, (-90, 90)).rays())
    # of the nearest of 60 rows
    np.testing.assert_allclose(panorama[~unknown], truth[~unknown], rtol=0.03)
