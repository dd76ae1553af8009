#!/usr/bin/env bash
# A depth TIFF in LERC with a NaN: tifffile reads its own file back as 0 m there, GDAL as NaN.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" tifffile==2026.3.3 imagecodecs==2026.3.6 numpy==2.4.6 rasterio==1.4.4
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import imagecodecs, numpy as np, rasterio, tifffile, warnings
warnings.simplefilter("ignore")
depth = np.random.default_rng(0).random((64, 64)).astype(np.float32) * 20 + 1
depth[10, 20] = np.nan
tifffile.imwrite("depth.tiff", depth, compression="lerc")
own = tifffile.imread("depth.tiff")
with rasterio.open("depth.tiff") as file:
    gdal = file.read(1)
print("imagecodecs", imagecodecs.__version__, "tifffile", tifffile.__version__, "→", own[10, 20])
print("rasterio", rasterio.__version__, "GDAL", rasterio.__gdal_version__, "→", gdal[10, 20])
assert own[10, 20] == 0 and np.isnan(gdal[10, 20])
known = np.isfinite(depth)
assert np.array_equal(own[known], depth[known]) and np.array_equal(gdal[known], depth[known])
PY
