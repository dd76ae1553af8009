#!/usr/bin/env bash
# Blender's world_to_camera_view answers for a panoramic camera as for a pinhole of 50 mm, and the Depth pass changes its meaning.
# Guessed before: that it follows the lens which renders, and that depth is along the axis for all lenses, or for none.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" bpy==5.0.1 OpenEXR==3.5.3
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import math, os
import bpy, numpy as np, OpenEXR
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
scene = bpy.context.scene
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)
camera = bpy.data.cameras.new("camera")
scene.camera = bpy.data.objects.new("camera", camera)
scene.collection.objects.link(scene.camera)  # looks along -z
scene.render.resolution_x = scene.render.resolution_y = 64
camera.type, camera.panorama_type, camera.fisheye_fov = "PANO", "FISHEYE_EQUIDISTANT", math.radians(220)
print("Blender", bpy.app.version_string, "fisheye of 220°: a point at an angle → its place in the width, true and as answered")
found = {}
for lens in (50, 18):
    camera.lens = lens  # mm; a fisheye has none, and its picture does not change
    for angle in (10, 30, 60, 100):
        point = Vector((math.sin(math.radians(angle)), 0, -math.cos(math.radians(angle))))
        found[lens, angle] = world_to_camera_view(scene, scene.camera, point).x
        print(f"{angle:3}° {0.5 + angle / 220:.3f} {found[lens, angle]:7.3f} with a lens of {lens} mm, which is not in use")
bpy.ops.mesh.primitive_plane_add(size=400, location=(0, 0, -2))  # a wall, 2 m in front
scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 1, "CPU"
scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01  # rays through the pixels' middles
bpy.context.view_layer.use_pass_z = True
settings = scene.render.image_settings
settings.media_type, settings.color_depth = "MULTI_LAYER_IMAGE", "32"
depth, angles = {}, (np.arange(12, 52) - 31.5) / 64 * 220  # of row 32, degrees
for kind in ("PERSP", "PANO"):
    camera.type, scene.render.filepath = kind, os.path.abspath(f"{kind}.exr")
    bpy.ops.render.render(write_still=True)
    parts = OpenEXR.File(f"{kind}.exr", separate_channels=True).parts
    depth[kind] = next(p.channels["ViewLayer.Depth.Z"].pixels for p in parts if "ViewLayer.Depth.Z" in p.channels)[32, 12:52]
    print(f"Depth of a wall 2 m in front, {kind}: {depth[kind].min():.2f} to {depth[kind].max():.2f}")
assert np.allclose([found[50, a] for a in (10, 30, 60, 100)], [0.745, 1.302, 2.906, -7.377], atol=0.001)
assert abs(found[18, 10] - 0.588) < 0.001
assert np.allclose(depth["PERSP"], 2) and np.allclose(depth["PANO"], 2 / np.cos(np.radians(angles)), rtol=0.01)
PY
