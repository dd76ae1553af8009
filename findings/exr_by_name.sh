#!/usr/bin/env bash
# OpenEXR's DWAA keeps depth exactly in a channel Z, and loses it, NaN included, in a channel Y or R.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" OpenEXR==3.5.3 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, OpenEXR
depth = np.random.default_rng(0).random((64, 64)).astype(np.float32) * 20 + 1
depth[3, 4], depth[5, 6] = np.nan, np.inf
known, found = np.isfinite(depth), {}
print("OpenEXR", OpenEXR.__version__, "depth of 1 to 21 m, float32, one NaN, one infinity")
for name in ("Z", "depth", "Y", "R", "depth.R", "A"):
    header = {"compression": OpenEXR.DWAA_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: depth.copy()}).write("z.exr")
    back = next(iter(OpenEXR.File("z.exr").channels().values())).pixels
    error = float(np.abs(back[known] / depth[known] - 1).max())
    found[name] = error
    print(f"channel {name:8} off by {100 * error:.2g} %, NaN → {back[3, 4]:g}, inf → {back[5, 6]:g}")
    assert np.isnan(back[3, 4]) == (error == 0)
assert all((error == 0) == (name in ("Z", "depth", "A")) for name, error in found.items()), found
PY
