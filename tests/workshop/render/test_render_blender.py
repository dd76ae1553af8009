"""One tiny frame with Blender, and where its camera model puts things."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lens_oracle import blender_pixel
from scene import polar_rays

import omnistereo_lib as osl
from workshop import render
from workshop.render.camera.lens import fit_ocam
from workshop.render.camera.render_rig import make_rig

SAMPLES = Path(osl.__file__).parents[1] / "data_samples" / "sunny"


BLENDER = render._BLENDER_PYTHON
needs_blender = pytest.mark.skipif(
    not list(BLENDER.parents[1].glob("lib/python*/site-packages/bpy")),
    reason="Blender's environment is not there: make render",
)


def in_blender(script, *arguments):
    """Run a script in Blender's interpreter, in the repository's root."""
    command = [BLENDER, "-c", script, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=BLENDER.parents[2], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]


ONE_FRAME = """
import sys
from dataclasses import replace
import bpy, numpy as np
from mathutils import Vector
from workshop.render import main
from workshop.render import SEED, SETS
from workshop.render.city.drive import plan_drive
from workshop.render.city.layout import plan_district
from omnistereo_lib.geometry.sphere import SphereGrid

out = sys.argv[1]
SETS["sunny/test"] = replace(SETS["sunny/test"], size=(50, 48), samples=1, truths=((64, 16),))
assert main(["sunny/test", "--frames", "831", "--out", out]) == 0

# The scene is still there: ask it where the rays end, and where rays a hundred-thousandth of a
# radian beside them do.
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
        "sunny/test/trajectory.txt",
        "sunny/test/omnidepth_gt_64/00831.tiff",
        *(f"sunny/test/cam{camera}/0831.jpg" for camera in (1, 2, 3, 4)),
    }
    data = osl.load_dataset(tmp_path / "sunny", split="test")
    assert len(data) == 1 and data[0].number == 831
    assert all(image.shape == (48, 50, 3) and 30 < image.mean() < 200 for image in data[0].images)
    truth = data[0].inverse_depth.astype(np.float64)
    assert truth.shape == (16, 64) and 0.02 < (truth == 0).mean() < 0.4

    cast = np.load(tmp_path / "cast.npz")
    # a ray along an edge may end on either side of it: one of seven will do
    expected = 1 / cast["distances"]
    error = np.abs(truth.ravel()[cast["chosen"], None] - expected) / np.where(
        expected > 0, expected, 1e-6
    )
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
from workshop.render.blender import empty_scene, fisheye_picture
from workshop.render.camera.lens import Lens
from workshop.render.camera.render_rig import make_rig

out, rays = sys.argv[1], np.load(sys.argv[1] + "/rays.npy")
empty_scene()
glow = bpy.data.materials.new("glow")
glow.use_nodes = True
glow.node_tree.nodes.clear()
kinds = "Emission", "OutputMaterial"
emission, output = (glow.node_tree.nodes.new(f"ShaderNode{kind}") for kind in kinds)
glow.node_tree.links.new(emission.outputs[0], output.inputs[0])
T_world_cam = Pose.from_vector([0.7, -0.4, 1.1, 3.0, -2.0, 1.5])
for ray in rays:
    place = T_world_cam @ (10 * ray)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.5, location=place)
    bpy.context.object.data.materials.append(glow)
lens = Lens(make_rig(5).cameras[0].lens.k, (419.5, 359.5))
np.save(out + "/picture.npy", fisheye_picture(lens, T_world_cam, (200, 192), 128, 0))
"""


@needs_blender
def test_balls_are_where_the_camera_model_says(tmp_path):
    """The chain of lens, shift, pose, row order; the axis is off the middle: a shift shows."""
    theta = np.radians([0, 25, 25, 25, 50, 50, 50, 75, 75, 75, 90, 90, 90, 104, 104, 104])
    rays = polar_rays(theta, np.arange(len(theta)) * np.radians(130))
    np.save(tmp_path / "rays.npy", rays)
    in_blender(BALLS, tmp_path)
    picture = np.load(tmp_path / "picture.npy").mean(-1)

    lens = replace(make_rig(5).cameras[0].lens, center=(419.5, 359.5))
    fit = fit_ocam(lens, 200)
    camera = osl.OcamCamera(fit.poly, fit.inv_poly, fit.center, (1, 0, 0), (200, 192))
    columns, rows = np.meshgrid(np.arange(200), np.arange(192))
    for (u, v), valid in zip(*camera.project(rays), strict=True):
        assert valid
        light = picture * (np.hypot(columns - u, rows - v) < 7)
        found = np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
        assert np.abs(found - (u, v)).max() < 0.1
    blender_uv = blender_pixel(lens, rays, (200, 192))
    np.testing.assert_allclose(camera.project(rays)[0], blender_uv, atol=0.01)
