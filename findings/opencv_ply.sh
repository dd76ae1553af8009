#!/usr/bin/env bash
# A cloud with an image's bytes as its colours, written by OpenCV as PLY: a photographic negative wherever it is opened.
# Guessed before: bytes as they are, or an error; `savePointCloud` takes them without a word, and states no range.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" opencv-python-headless==5.0.0.93 pymeshlab==2025.7.post1 pyvista==0.49.1 trimesh==5.2.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np, pymeshlab, pyvista, trimesh
gray = np.array([0, 10, 60, 127, 200, 255], np.uint8)
colors = np.repeat(gray[:, None], 3, 1)  # as they come out of a picture
points = np.random.default_rng(0).random((1, 6, 3)).astype(np.float32)

def readers(path):
    yield f"OpenCV {cv2.__version__}", cv2.loadPointCloud(path)[2][:, 0, 0] * 255
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(path)
    yield "MeshLab 2025.7", meshes.current_mesh().vertex_color_matrix()[:, 0] * 255
    yield f"VTK, pyvista {pyvista.__version__}", pyvista.read(path).point_data["RGB"][:, 0]
    yield f"trimesh {trimesh.__version__}", trimesh.load(path).colors[:, 0]

print("written:", gray.tolist())
for name, given in (("bytes", colors), ("floats to 255", colors.astype(np.float32)), ("floats to 1", colors / np.float32(255))):
    cv2.savePointCloud("c.ply", points, np.array([]), given[None])
    lines = open("c.ply").read().split("end_header\n")[1].splitlines()
    print(f"{name}: `property uchar red` holds {[int(line.split()[3]) for line in lines]}")
    for reader, found in readers("c.ply"):
        print(f"  {reader:22}", np.round(found).astype(int).tolist())
        expected = gray.astype(int) if name == "floats to 1" else -gray.astype(int) % 256
        assert np.abs(found - expected).max() < 1.5
PY
