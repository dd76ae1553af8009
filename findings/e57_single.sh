#!/usr/bin/env bash
# A scan in map coordinates, written as float64 by pye57, is up to 25 cm off when it is read back, as float64.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" pye57==0.4.19 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, pye57
points = np.array([[500123.4567, 5412345.6789, 312.3456], [500124.0123, 5412346.0123, 313.0]])  # UTM, metres
def kept(scan, offset):
    file = pye57.E57("scan.e57", mode="w")
    file.write_scan_raw({f"cartesian{axis}": scan[:, k].copy() for k, axis in enumerate("XYZ")}, translation=offset)
    file.close()
    read = pye57.E57("scan.e57").read_scan(0, ignore_missing_fields=True)
    return np.column_stack([read[f"cartesian{axis}"] for axis in "XYZ"])
plain, moved = kept(points, np.zeros(3)), kept(points - points[0], points[0])
print("pye57 0.4.19: back as", plain.dtype, "off by", np.abs(plain - points).max(0).round(4).tolist(), "metres")
print("around their first point, which is the scan's translation:", np.abs(moved - points).max())
assert plain.dtype == np.float64 and 0.1 < np.abs(plain - points)[:, 1].max() < 0.26
assert np.abs(moved - points).max() < 1e-6
PY
