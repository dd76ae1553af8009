#!/usr/bin/env bash
# Float depth as JPEG XL by imagecodecs: with distance=0 one NaN spoils half of 64 × 64 pixels; lossless=True keeps all.
# Guessed before: that a distance of 0 is lossless, as libjxl's documentation has it, or that NaN spoils its own block.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" imagecodecs==2026.3.6 numpy==2.4.6
PYTHONPATH=$site python3 - <<'PY'
import imagecodecs, numpy as np
print("imagecodecs", imagecodecs.__version__, imagecodecs.jpegxl_version())
depth = np.geomspace(0.1, 300, 64 * 64, dtype=np.float32).reshape(64, 64)  # metres
hole = depth.copy()
hole[5, 5] = np.nan
wrong = {}
for name, image in (("depth", depth), ("one NaN", hole)):
    for options in ({"distance": 0}, {"lossless": True}):
        back = imagecodecs.jpegxl_decode(imagecodecs.jpegxl_encode(image, **options))
        errors = np.nan_to_num(abs(back / depth - 1), nan=np.inf)
        wrong[name, *options] = 100 * (errors > 0.1).mean()
        same = np.array_equal(back, image, equal_nan=True)
        print(f"{name}, {options}: same bits {same}, {wrong[name, *options]:.2f} % of pixels 10 % off, at the NaN {back[5, 5]:.3g}")
        assert same == ("lossless" in options)
assert wrong["depth", "distance"] == 0 and wrong["one NaN", "distance"] == 50
PY
