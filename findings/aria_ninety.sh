#!/usr/bin/env bash
# Project Aria's lens models beyond 90° from the axis: one is right, two answer from the other side, and the pinhole
# sees what is behind it.
# Guessed before: that all four answer alike, with None or with the right side.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --no-deps --target "$site" projectaria-tools==2.3.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
import numpy as np
from projectaria_tools.core import calibration
from projectaria_tools.core.sophus import SE3
here, size = SE3.from_matrix(np.eye(4)), (1280, 640)
middle = [639.5, 319.5]

def fisheye(model, numbers):
    return calibration.CameraCalibration("lens", model, np.array(numbers), here, *size, None, np.radians(110), "")

model = calibration.CameraModelType
cameras = {  # all with a focal length of 200 pixels, the fisheyes without distortion: 200 pixels a radian
    "KANNALA_BRANDT_K3": fisheye(model.KANNALA_BRANDT_K3, [200, 200, *middle, 0, 0, 0, 0]),
    "FISHEYE624": fisheye(model.FISHEYE624, [200, *middle, *[0] * 12]),
    "SPHERICAL": calibration.get_spherical_camera_calibration(*size, 200, "panorama", here),
    "LINEAR": calibration.get_linear_camera_calibration(*size, 200, "pinhole", here),
}
print("projectaria-tools", version("projectaria-tools"), "ray → project, u − cx → unproject")
found = {}
for name, camera in cameras.items():
    for degrees in (30, 89, 91, 100, 170):
        ray = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
        pixel = camera.project(ray)
        back = None if pixel is None else camera.unproject(pixel)
        angle = None if back is None else float(np.degrees(np.arctan2(back[0], back[2])))
        found[name, degrees] = (None if pixel is None else float(pixel[0] - middle[0]), angle)
        print(f"{name:18} {degrees:4}° →", *("None" if x is None else f"{x:8.1f}" for x in found[name, degrees]))
at_100 = {name: found[name, 100] for name in cameras}
np.testing.assert_allclose(at_100["KANNALA_BRANDT_K3"], (200 * np.radians(100), 100), atol=0.01)
np.testing.assert_allclose(at_100["SPHERICAL"], (200 * np.radians(100), -80), atol=0.01)
np.testing.assert_allclose(at_100["FISHEYE624"], (-200 * np.radians(80), -80), atol=0.01)
np.testing.assert_allclose(found["LINEAR", 170], (-200 * np.tan(np.radians(10)), -10), atol=0.01)
assert found["LINEAR", 89] == (None, None)
assert all(abs(found[name, 30][1] - 30) < 0.01 for name in cameras)
PY
