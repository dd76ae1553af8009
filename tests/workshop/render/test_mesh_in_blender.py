"""A mesh of `omnistereo depth --mesh` in Blender: metres, z up, texture on its rays."""

import json

import cv2
import numpy as np
import pytest
import scene
from test_render_blender import in_blender, needs_blender

import omnistereo_lib as osl
from omnistereo_tools.output.mesh_export import write_mesh
from omnistereo_tools.output.points import Limits

pytest.importorskip("trimesh", reason="trimesh is not installed: environment.txt has it")

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)

# Blender looks from the centre of the rig along its +z, which is Blender's +y, with x to the right
# and up upwards.
OPEN = """
import json, sys
import bpy, numpy as np
folder = sys.argv[1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=folder + "/a.glb")
scene, (mesh,) = bpy.context.scene, [item for item in bpy.data.objects if item.type == "MESH"]
points = [mesh.matrix_world @ vertex.co for vertex in mesh.data.vertices]
np.save(folder + "/points.npy", np.array(points))
(image,) = bpy.data.images
about = {"metres": scene.unit_settings.scale_length, "texture": list(image.size)}
about["packed"] = bool(image.packed_file)
json.dump(about, open(folder + "/about.json", "w"))
scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
lens = scene.camera.data
lens.lens_unit, lens.angle, lens.clip_start = "FOV", np.pi / 2, 0.01
scene.camera.rotation_euler = (np.pi / 2, 0, 0)
scene.collection.objects.link(scene.camera)
nodes, links = mesh.data.materials[0].node_tree.nodes, mesh.data.materials[0].node_tree.links
kinds = "TEX_IMAGE", "BSDF_PRINCIPLED"
(texture,), (surface,) = ([node for node in nodes if node.type == kind] for kind in kinds)
assert surface.inputs["Base Color"].links[0].from_node == texture
glow = nodes.new("ShaderNodeEmission")  # no light: it glows in its colours
links.new(texture.outputs["Color"], glow.inputs["Color"])
links.new(glow.outputs["Emission"], surface.outputs["BSDF"].links[0].to_socket)
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
scene.view_settings.view_transform = "Standard"
scene.render.resolution_x = scene.render.resolution_y = 64
scene.render.image_settings.file_format, scene.render.filepath = "PNG", folder + "/picture.png"
bpy.ops.render.render(write_still=True)
"""


@needs_blender
def test_blender_opens_the_mesh_in_metres_upright_and_textured(tmp_path):
    rig = scene.rig(width=200, height=192)
    row, column = np.indices((80, 320))
    # a colour is a direction
    panorama = np.stack([column * 255 // 319, row * 255 // 79, 0 * row], -1).astype(np.uint8)
    depth = scene.true_depth(rig, GRID)
    write_mesh(tmp_path / "a.glb", depth, panorama, Limits(100.0, 0.0))
    in_blender(OPEN, tmp_path)

    about = json.loads((tmp_path / "about.json").read_text())
    assert about == {"metres": 1.0, "texture": [320, 80], "packed": True}
    x, y, z = np.load(tmp_path / "points.npy").T
    points = np.stack([x, -z, y], -1)  # in the axes of the rig: right, down, forward
    np.testing.assert_allclose(scene.beyond_walls(points, rig), 1, atol=1e-4)

    picture = cv2.cvtColor(cv2.imread(str(tmp_path / "picture.png")), cv2.COLOR_BGR2RGB).astype(
        float
    )
    right, down = (np.indices((64, 64))[::-1] + 0.5) / 32 - 1
    theta, phi = np.arctan2(right, 1), np.arctan2(down, np.hypot(right, 1))
    inside = np.abs(phi) < np.radians(36)
    np.testing.assert_allclose(
        picture[..., 0][inside], (theta / (2 * np.pi) + 0.5)[inside] * 255, atol=5
    )
    np.testing.assert_allclose(
        picture[..., 1][inside], (phi / (np.pi / 2) + 0.5)[inside] * 255, atol=5
    )
