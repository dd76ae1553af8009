#!/usr/bin/env bash
# The median of 3 x 3 depths, of which one is unknown: no NaN, and no median either.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np, scipy
from scipy.ndimage import median_filter
window = np.arange(1, 10, dtype=np.float32)
wrong = {"cv2": 0, "scipy": 0}
print("one window of 1 … 9 without one; cv2", cv2.__version__, "scipy", scipy.__version__)
for hole in range(9):
    holed = window.copy()
    holed[hole] = np.nan
    tiled = np.tile(holed.reshape(3, 3), (3, 11))
    truth = np.nanmedian(holed)  # between the fourth and the fifth of eight
    for name, median in (("cv2", cv2.medianBlur(tiled, 3)), ("scipy", median_filter(tiled, 3))):
        row = median[4, 1:-1]
        print(f"without {window[hole]:g}: {name:6} {np.unique(row)}, of the others {truth}")
        wrong[name] += bool((np.abs(row - truth) > 1).any())
# Which of the numbers comes depends on where the hole is in the window, and in OpenCV on the processor.
assert wrong["cv2"] >= 3 and wrong["scipy"] == 3, wrong
PY
