#!/usr/bin/env bash
# An AprilTag that OpenCV draws is upside down for AprilTag's own detector, and OpenCV's refinement decides on half a pixel.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" pupil-apriltags==1.0.4.post11 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np, pupil_apriltags
family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
image = np.full((240, 240), 255, np.uint8)
image[40:200, 40:200] = cv2.aruco.generateImageMarker(family, 3, 160)
print("the black square's edges are at 39.5 and 199.5 where pixel centres are whole numbers; cv2", cv2.__version__)
first = {}
for name in ("SUBPIX", "APRILTAG"):
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{name}")
    first[name] = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(image)[0][0][0]
    print(f"{name:10}", first[name].round(2).tolist())
tag, = pupil_apriltags.Detector(families="tag36h11").detect(image)
print("pupil-apriltags 1.0.4.post11, from the lower left, as documented:", tag.corners.round(1).tolist())
assert np.abs(first["SUBPIX"][[0, 2]] - [[39.5], [199.5]]).max() < 0.1
assert np.abs(first["APRILTAG"][[0, 2]] - [[40], [200]]).max() < 0.1
# Its lower left corner is the image's upper right one.
assert np.abs(tag.corners[0] - [200, 40]).max() < 0.3
PY
