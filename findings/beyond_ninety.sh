#!/usr/bin/env bash
# A fisheye pixel a little beyond 90° from the axis gets a ray that looks like any other, or an enormous one.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 opencv-python-headless==5.0.0.93 pycolmap==4.2.1 poselib==2.0.5
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
import cv2, numpy as np, poselib, pycolmap
# An equidistant lens of 229°: 200 px per radian, no distortion. Its pixel on the right at 89°, 91° and 110°.
f, angles = 200.0, (89, 91, 110)
pixels = [np.array([[400 + f * np.radians(angle), 400.0]]) for angle in angles]
parameters = [f, f, 400, 400, 0, 0, 0, 0]
K = np.array([[f, 0, 400], [0, f, 400], [0, 0, 1]])
colmap = pycolmap.Camera(model="OPENCV_FISHEYE", width=800, height=800, params=parameters)
pose = poselib.Camera("OPENCV_FISHEYE", parameters, 800, 800)
degrees = lambda ray: round(float(np.degrees(np.arctan2(ray[0], ray[2]))), 1)
plane = lambda point: round(float(np.degrees(np.arctan(point[0, 0]))), 1)
found = {
    f"pycolmap {version('pycolmap')} cam_ray_from_img": [degrees(colmap.cam_ray_from_img(p)[0]) for p in pixels],
    f"PoseLib {version('poselib')} unproject": [plane(pose.unproject(p)) for p in pixels],
    f"OpenCV {cv2.__version__} undistortPoints": [plane(cv2.fisheye.undistortPoints(p[None], K, np.zeros(4))[0]) for p in pixels],
}
print(f"{'pixel at':38} {angles}, in degrees")
for name, value in found.items():
    print(f"{name:38} {value}")
# And the other way: a ray at 91° is projected to the pixel on the left at 89°.
ray = np.array([[[np.sin(np.radians(91)), 0, np.cos(np.radians(91))]]])
back = cv2.fisheye.projectPoints(ray, np.zeros(3), np.zeros(3), K, np.zeros(4))[0][0, 0, 0]
left = float(np.degrees((back - 400) / f))
print(f"OpenCV {cv2.__version__} projectPoints, a ray at 91°: the pixel at {left:.1f}°")
assert list(found.values()) == [[89.0, 57.8, 62.5], [89.0, -89.0, -70.0], [89.0, 90.0, 90.0]]
assert abs(left + 89) < 0.1
PY
