#!/usr/bin/env bash
# A panorama turned into a cube and back by py360convert comes back half a pixel of a face lower at its horizon.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" py360convert==1.0.4 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, py360convert
height, width = 128, 256
rows = np.repeat(np.arange(height, dtype=float)[:, None], width, 1)[..., None].repeat(3, -1)  # each pixel holds its row
found = {}
for face in (64, 128, 256):
    cube = py360convert.e2c(rows, face_w=face, cube_format="dict")
    back = py360convert.c2e(cube, height, width, cube_format="dict")
    found[face] = float(np.median((back - rows)[64]))
    degrees = found[face] * 180 / height
    print(f"py360convert 1.0.4, faces of {face:3}: row 64 holds {64 + found[face]:.2f}, {degrees / (90 / face):.2f} of a pixel of a face")
assert all(0.3 < value * face / 64 < 0.7 for face, value in found.items()), found
PY
