#!/usr/bin/env bash
# laspy: `add_extra_dim` after the scales of a header were set makes coordinates ten times smaller.
# Guessed before: that what was written stays where it is, whatever is added to it.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" laspy==2.7.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 -W error - <<'PY'
import laspy, numpy as np
points = np.array([[12.34, 5.6, 7.8]])
las = laspy.create(point_format=7, file_version="1.4")
las.header.scales = [0.001] * 3
las.xyz = points
before = las.xyz[0].copy()
las.add_extra_dim(laspy.ExtraBytesParams("confidence", np.float32))
las.write("a.las")
header = laspy.LasHeader(point_format=7, version="1.4")
header.scales = np.full(3, 0.001)
first = laspy.LasData(header)
first.xyz = points
first.add_extra_dim(laspy.ExtraBytesParams("confidence", np.float32))
first.write("b.las")
found, right = laspy.read("a.las").xyz[0], laspy.read("b.las").xyz[0]
print("laspy", laspy.__version__, ":", before, "; with a dimension more", las.xyz[0], "; in the file", found, "; scales first:", right)
assert np.allclose(before, points[0]) and np.allclose(found, points[0] / 10) and np.allclose(right, points[0])
PY
