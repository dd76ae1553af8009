#!/usr/bin/env bash
# ZFP with a tolerance of 1 cm: an unknown depth comes back as -64 m, its neighbours right.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" imagecodecs==2026.3.6 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import imagecodecs, numpy as np
depth = np.random.default_rng(0).random((64, 64)).astype(np.float32) * 20 + 1
depth[10, 20] = np.nan
kept = imagecodecs.zfp_decode(imagecodecs.zfp_encode(depth))
lossy = imagecodecs.zfp_decode(imagecodecs.zfp_encode(depth, mode="a", level=0.01))
print("imagecodecs", imagecodecs.__version__, "reversible:", kept[10, 20], "tolerance 0.01:", lossy[10, 20])
print("largest error of the others:", np.nanmax(np.abs(lossy - depth)))
assert np.isnan(kept[10, 20]) and abs(lossy[10, 20] + 64) < 0.1 and np.nanmax(np.abs(lossy - depth)) <= 0.01
PY
