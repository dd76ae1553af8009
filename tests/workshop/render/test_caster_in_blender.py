"""The caster of the endless worlds against Blender: boxes, ellipsoids, cylinders."""

from pathlib import Path

import numpy as np
import pytest
from test_render_blender import in_blender, needs_blender

import omnistereo_lib as osl
from omnistereo_learn.endless.caster import BOX, CYLINDER, ELLIPSOID, LIGHT, PRIMITIVE
from omnistereo_learn.endless.worlds import Scene

# A room full of things in the air, drawn once by `train.endless.scenes`, and Blender's inverse
# depth, in 1/m.
STORED = Path(__file__).with_name("caster_in_blender.npz")
GRID = osl.SphereGrid(128, 64, (-90, 90), min_depth=1.0)

RENDER = """
import sys
import bpy, mathutils, numpy as np
from omnistereo_lib.geometry.pose import Pose
from workshop.render.blender import depth_panorama, empty_scene

scene = np.load(sys.argv[1])
empty_scene()
upright = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)])  # Blender's cylinder stands along z
bpy.ops.mesh.primitive_cube_add(size=2)
bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
bpy.ops.mesh.primitive_cylinder_add(vertices=256, radius=1, depth=2)
meshes = [bpy.data.meshes[name] for name in ("Cube", "Sphere", "Cylinder")]
bpy.data.batch_remove([item for item in bpy.data.objects if item.type == "MESH"])
names = "shape", "rotation", "center", "half"
for shape, rotation, center, half in zip(*(scene[k] for k in names)):
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T * half @ (upright if shape == 2 else np.eye(3))
    matrix[:3, 3] = center
    item = bpy.data.objects.new("item", meshes[shape])
    item.matrix_world = mathutils.Matrix(matrix.tolist())
    bpy.context.scene.collection.objects.link(item)
np.save(sys.argv[2], 1 / depth_panorama(Pose.identity(), (128, 64), 90.0))
"""


@pytest.mark.parametrize("source", ["stored", pytest.param("rendered now", marks=needs_blender)])
def test_the_depth_is_blenders(source, tmp_path):
    stored = np.load(STORED)
    expected = stored["inverse_depth"]
    if source != "stored":
        in_blender(RENDER, STORED, tmp_path / "inverse.npy")
        expected = np.load(tmp_path / "inverse.npy")
    primitives = np.zeros(len(stored["shape"]), PRIMITIVE)
    for name in ("shape", "rotation", "center", "half"):
        primitives[name] = stored[name]
    assert set(primitives["shape"]) == {BOX, ELLIPSOID, CYLINDER}
    found = Scene(primitives, np.zeros(1, LIGHT)[0]).inverse_depth_along(GRID.rays())
    # Blender's round shapes have 256 sides, and its samples lie a little off the middle of a pixel.
    np.testing.assert_allclose(found, expected, rtol=5e-4)
    assert np.median(np.abs(found - expected)) < 1e-6
