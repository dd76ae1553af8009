#!/usr/bin/env bash
# BORDER_WRAP around a panorama: OpenCV's box, bilateral and pyramid take it, Gauss, Sobel and dilate do not.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np
image = np.zeros((6, 12), np.float32)
image[:, 0] = 12
wrap = {"borderType": cv2.BORDER_WRAP}
calls = {
    "blur": lambda: cv2.blur(image, (3, 1), **wrap),
    "bilateralFilter": lambda: cv2.bilateralFilter(image, 3, 100, 2, **wrap),
    "pyrDown": lambda: cv2.pyrDown(image, **wrap),
    "GaussianBlur": lambda: cv2.GaussianBlur(image, (3, 1), 0, **wrap),
    "Sobel": lambda: cv2.Sobel(image, -1, 1, 0, **wrap),
    "dilate": lambda: cv2.dilate(image, np.ones((1, 3)), **wrap),
}
print("cv2", cv2.__version__)
reaches = {}
for name, call in calls.items():
    try:
        reaches[name] = bool(call()[2, -1] > 0)
    except cv2.error as error:
        reaches[name] = None
    print(f"{name:16}", {True: "goes around", None: "refuses"}[reaches[name]])
assert list(reaches.values()) == [True, True, True, None, None, None], reaches
PY
