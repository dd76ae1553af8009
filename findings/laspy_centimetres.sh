#!/usr/bin/env bash
# A new LAS file of laspy holds whole centimetres, of which nothing is said.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" laspy==2.7.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import laspy, numpy as np
points = np.array([[1.2345, -0.0049, 2.0], [2.3456, 0.0049, 3.0]])
cloud = laspy.create(point_format=7, file_version="1.4")
cloud.xyz = points
cloud.write("a.las")
back = laspy.read("a.las")
print("laspy", laspy.__version__, "scale", back.header.scales)
print(points.tolist(), "→", np.asarray(back.xyz).tolist())
assert np.all(back.header.scales == 0.01) and np.allclose(back.xyz, points.round(2))
PY
