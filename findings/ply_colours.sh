#!/usr/bin/env bash
# Colours in a PLY that are not bytes: black, white, or 257 times too bright, each reader in its own way.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" open3d==0.20.0 pymeshlab==2025.7.post1 trimesh==5.2.0 pyvista==0.49.1 plyfile==1.1.5 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import logging
import numpy as np, open3d, pymeshlab, pyvista, trimesh
from plyfile import PlyData, PlyElement
def readers(path):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(path)
    yield "Open3D", np.asarray(open3d.io.read_point_cloud(path).colors)[:, 0]
    yield "MeshLab", meshes.current_mesh().vertex_color_matrix()[:, 0]
    yield "VTK", pyvista.read(path).point_data["RGB"][:, 0] / 255
    yield "trimesh", trimesh.load(path).visual.vertex_colors[:, 0] / 255
print("open3d", open3d.__version__, "pymeshlab 2025.7.post1, pyvista", pyvista.__version__, "trimesh", trimesh.__version__)
found = {}
for name, kind, values in (("uchar", "u1", (0, 128, 255)), ("ushort", "u2", (0, 32896, 65535)), ("float", "f4", (0, 0.5, 1))):
    rows = np.zeros(3, [*((axis, "f4") for axis in "xyz"), *((color, kind) for color in ("red", "green", "blue"))])
    rows["x"], rows["y"] = (0, 1, 0), (0, 0, 1)
    rows["red"] = rows["green"] = rows["blue"] = values
    face = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    PlyData([PlyElement.describe(rows, "vertex"), PlyElement.describe(face, "face")]).write("c.ply")
    for reader, colors in readers("c.ply"):
        found[name, reader] = colors
        print(f"0, half, full as {name:7} {reader:8}", np.round(colors, 3))
right = [0, 128 / 255, 1]
assert all(np.allclose(found["uchar", reader], right) for reader in ("Open3D", "MeshLab", "VTK", "trimesh"))
assert np.allclose(found["ushort", "Open3D"], [0, 129, 257], atol=0.01)
assert np.allclose(found["float", "Open3D"], [0, 0.5 / 255, 1 / 255]) and np.all(found["float", "VTK"] < 0.01)
assert np.all(found["ushort", "MeshLab"] == 1) and np.all(found["float", "MeshLab"] == 1)
assert np.allclose(found["float", "trimesh"], right) and np.allclose(found["ushort", "trimesh"], right)
PY
