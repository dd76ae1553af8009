#!/usr/bin/env bash
# trimesh's camera counts the rows of its pixels from the bottom of the picture.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" trimesh==5.2.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, trimesh
scene = trimesh.Scene([trimesh.creation.box()])
scene.camera = trimesh.scene.Camera(resolution=(4, 4), fov=(90, 90))
scene.camera_transform = np.eye(4)  # as in OpenGL: y up, looks along -z
_, rays, pixels = scene.camera_rays()
top = pixels[rays[:, 1] == rays[:, 1].max()]
print("trimesh", trimesh.__version__, "pixels (column, row) of the highest rays:", top.tolist())
assert set(top[:, 1]) == {3}
PY
