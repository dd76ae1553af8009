#!/usr/bin/env bash
# A white fisheye picture of 180° becomes a panorama whose front is white in one quarter, black in the others, and
# what the picture has on its right is on the left.
# Guessed before: that all of the front is white, and that delx and dely move the centre.
# Met by others: https://github.com/kaustubh-sadekar/OmniCV-Lib/issues/38 and 43; the package is as it was.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --no-deps --target "$site" omnicv==1.1.3 numpy==2.4.6 opencv-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
import cv2, numpy as np
from omnicv import fisheyeImgConv
picture = np.full((401, 401, 3), 255, np.uint8)
right = picture.copy()
right[:, :201] = 0

def panorama(**shift):
    converter = fisheyeImgConv()
    image = converter.fisheye2equirect(picture, (200, 400), aperture=180, radius=200, edit_mode=True, **shift)
    return converter, image[..., 0] > 0

converter, white = panorama()
centre = np.float32(200)
maps = converter.map_x + centre, converter.map_y + centre
seen, of_right = (cv2.remap(image, *maps, cv2.INTER_NEAREST)[..., 0] > 0 for image in (picture, right))
front = np.s_[5:195, 105:295]
print("omnicv", version("omnicv"), f"front white: {white[front].mean():.2f}")
print(f"with the centre added to its map: {seen[front].mean():.2f}; columns of the map from", *converter.map_x[100, [0, -1]])
assert seen[front].mean() == 1 and 0.24 < white[front].mean() < 0.27
assert white[105:195, 105:195].mean() == 1  # the lower right of the picture, on the left
assert of_right[5:195, 105:195].all() and not of_right[5:195, 205:295].any()
assert (panorama(delx=50, dely=50)[1] == white).all()
PY
