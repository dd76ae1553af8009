#!/usr/bin/env bash
# mode='wrap' around a ring of eight columns: in SciPy the ring has seven, in JAX's function of the same name eight.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 scipy==1.17.1 jax==0.10.2 scikit-image==0.26.0 opencv-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, jax, numpy as np, scipy, skimage
from jax.scipy.ndimage import map_coordinates as jax_map
from scipy.ndimage import map_coordinates
from skimage.transform import warp
row, at = np.arange(8.0), np.array([7.5, 8.0, 8.5, -0.5])
rows, ats = np.tile(row, (8, 1)), at[None].astype(np.float32)
found = {
    f"scipy {scipy.__version__} wrap": map_coordinates(row, [at], order=1, mode="wrap"),
    f"scipy {scipy.__version__} grid-wrap": map_coordinates(row, [at], order=1, mode="grid-wrap"),
    f"jax {jax.__version__} wrap": np.asarray(jax_map(row, [at], order=1, mode="wrap")),
    f"skimage {skimage.__version__} wrap": warp(
        rows, np.stack([0 * ats, ats]), order=1, mode="wrap", preserve_range=True
    )[0],
    f"cv2 {cv2.__version__} BORDER_WRAP": cv2.remap(
        rows.astype(np.float32), ats, 0 * ats + 3, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )[0],
}
print("columns", at)
for name, values in found.items():
    print(f"{name:28}", values)
wrap, *others = found.values()
assert np.allclose(wrap, [0.5, 1, 1.5, 6.5])
assert all(np.allclose(values, [3.5, 0, 0.5, 3.5]) for values in others)
PY
