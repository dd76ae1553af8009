#!/usr/bin/env bash
# DepthAI's ImgTransformation, fisheye to panorama: beyond 90° a pixel goes to the other side, an ideal fisheye counts
# as a pinhole. Guessed before: that it follows the model, or NaN beyond 90° as the documentation says.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" depthai==3.12.0 numpy==2.4.6
cd "$site" && DEPTHAI_LEVEL=error PYTHONPATH=$site python3 - <<'PY'
import math
import depthai as dai

def made(size, focal, model, k1=0.0):
    K = [[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]]
    return dai.ImgTransformation(*size, K, model, [k1] + [0.0] * 13)

# One pixel a degree, equidistant: 220° of a fisheye, 360° × 180° of a panorama.
focal = 180 / math.pi
ideal = made((220, 220), focal, dai.CameraModel.Fisheye)
fisheye = made((220, 220), focal, dai.CameraModel.Fisheye, 1e-9)  # at 110° it moves a pixel by less than 1e-6
panorama = made((360, 180), focal, dai.CameraModel.Equirectangular)
pinhole = made((220, 220), focal, dai.CameraModel.Perspective)
print("depthai", dai.__version__)
for name, image, true in (("fisheye", fisheye, 220), ("panorama", panorama, 360)):
    print(f"{name}: getHFov {image.getHFov():.1f}°, true {true}°")

def longitude(image, angle):
    return image.remapPointTo(panorama, dai.Point2f(110 + angle, 110)).x - 180

angles = (30, 60, 89, 91, 100)
for angle in angles:
    print(f"pixel at {angle}°: longitude {longitude(fisheye, angle):.1f}°, k1 = 0: {longitude(ideal, angle):.1f}°")
    wrapped = angle if angle < 90 else angle - 180
    assert abs(longitude(fisheye, angle) - wrapped) < 0.01
    assert abs(longitude(ideal, angle) - math.degrees(math.atan(math.radians(angle)))) < 0.01
# The documentation of remapPointTo, of such targets: "NaN coordinates for rays with z <= 0".
flat = fisheye.remapPointTo(pinhole, dai.Point2f(110 + 100, 110)).x - 110
back = panorama.remapPointTo(fisheye, dai.Point2f(180 + 100, 90)).x
print(f"pixel at 100° in a pinhole image: {flat:.1f} px from the middle; from the panorama at 100°: {back}")
assert abs(flat - focal * math.tan(math.radians(100))) < 0.1 and math.isnan(back)
assert abs(fisheye.getHFov() - 125.0) < 0.1 and abs(panorama.getHFov() - 144.7) < 0.1
PY
