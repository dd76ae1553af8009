#!/usr/bin/env bash
# librealsense projects by its lens models and takes the pixels back by others: 40° come back as 40.9° or 46.5°.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --no-deps --target "$site" pyrealsense2==2.59.1.11053
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import math
import pyrealsense2 as rs
print("pyrealsense2", rs.__version__, "f 200: ray at 20°, 40°, 60°, 100° → pixel u − cx → ray")
found = {}
brown, kannala = [0.05, -0.02, 0.001, 0.002, 0.01], [0.05, -0.01, 0.001, 0.0005, 0]
models = {"none": [0] * 5, "inverse_brown_conrady": brown, "modified_brown_conrady": brown}
for name, numbers in (models | {"ftheta": [0.9, 0, 0, 0, 0], "kannala_brandt4": kannala}).items():
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = 640, 480, 200, 200, 320, 240
    lens.model, lens.coeffs = getattr(rs.distortion, name), numbers
    for degrees in (20, 40, 60, 100):
        ray = [math.sin(math.radians(degrees)), 0, math.cos(math.radians(degrees))]
        pixel = rs.rs2_project_point_to_pixel(lens, ray)
        x, _, z = rs.rs2_deproject_pixel_to_point(lens, pixel, 1)
        found[name, degrees] = pixel[0] - 320, math.degrees(math.atan2(x, z))
    print(f"{name:24}", *(f"{u:11.1f} → {back:5.1f}°" for (model, _), (u, back) in found.items() if model == name))
for name in ("none", "inverse_brown_conrady", "kannala_brandt4"):
    assert abs(found[name, 40][1] - 40) < 0.01
    assert name == "inverse_brown_conrady" or abs(found[name, 100][1] + 80) < 0.1  # behind the camera, and mirrored
plain = math.degrees(math.atan(found["modified_brown_conrady", 40][0] / 200))
assert abs(found["modified_brown_conrady", 40][1] - plain) < 0.01 and plain > 40.9  # as if there were no distortion
assert abs(found["inverse_brown_conrady", 60][1] - 62.6) < 0.1 and abs(found["ftheta", 40][1] - 46.5) < 0.1
PY
