#!/usr/bin/env bash
# One unknown pixel of 32 x 64, then a mean over 5 x 5, or half the size: how many become unknown.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 scipy==1.17.1 jax==0.10.2 scikit-image==0.26.0 opencv-python-headless==5.0.0.93 pillow==13.0.0
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, jax, numpy as np, scipy, skimage
from PIL import Image
from scipy.ndimage import uniform_filter
from skimage.transform import resize
depth = np.random.default_rng(0).random((32, 64)).astype(np.float32)
depth[10, 21] = np.nan
found = {
    f"mean, cv2 {cv2.__version__} blur": cv2.blur(depth, (5, 5)),
    "mean, cv2 filter2D": cv2.filter2D(depth, -1, np.full((5, 5), 0.04)),
    f"mean, scipy {scipy.__version__} uniform_filter": uniform_filter(depth, 5),
    "half, cv2 INTER_AREA": cv2.resize(depth, (32, 16), interpolation=cv2.INTER_AREA),
    "half, Pillow BOX": np.asarray(Image.fromarray(depth).resize((32, 16), Image.Resampling.BOX)),
    f"half, jax {jax.__version__} linear": np.asarray(jax.image.resize(depth, (16, 32), "linear")),
    f"half, skimage {skimage.__version__} order 3": resize(depth, (16, 32), order=3, anti_aliasing=False),
}
unknown = {name: int(np.isnan(values).sum()) for name, values in found.items()}
for name, count in unknown.items():
    print(f"{name:36} {count}")
blur, filtered, uniform, area, box, linear, cubic = unknown.values()
# Running sums never forget a NaN; a product with a whole matrix of weights multiplies it by zero.
assert filtered == 25 and blur > 100 and uniform > 1000 and area == box == 1 and linear == cubic == 16 * 32
PY
