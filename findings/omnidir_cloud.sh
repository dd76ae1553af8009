#!/usr/bin/env bash
# OpenCV's omnidirectional stereo leaves out of its cloud whatever has a disparity of 15 px or less, and as longitude and
# latitude it puts the rest too far away.
# Guessed before: a point for each pixel that has a disparity, where the two rays meet.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" opencv-contrib-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np
# Two equal lenses of about 190° (xi = 1, no distortion), parallel, 20 cm apart, in a room of 6 × 4 × 8 m.
size, baseline, xi = 640, 0.2, np.array([1.0])
K, D = np.array([[300, 0, 319.5], [0, 300, 319.5], [0, 0, 1]]), np.zeros((1, 4))
v, u = np.mgrid[:size, :size]
x, y = (u - 319.5) / 300, (v - 319.5) / 300
scale = 2 / (1 + x**2 + y**2)
rays = np.dstack([scale * x, scale * y, scale - 1])
waves = np.random.default_rng(0).normal(size=(40, 3)) * 30  # the walls' texture, radians a metre

def picture(place):
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0, np.array([3, 2, 4]) - place, -np.array([3, 2, 4]) - place) / rays
    walls = place + reach.min(-1)[..., None] * rays
    gray = sum(np.sin(walls @ wave) for wave in waves)
    return np.repeat((gray * 12 + 128).clip(0, 255).astype(np.uint8)[..., None], 3, -1)

pair = picture(np.zeros(3)), picture(np.array([baseline, 0, 0]))
print("cv2", cv2.__version__, "omnidir.stereoReconstruct")
found = {}
for name, n in (("PERSPECTIVE", 640), ("LONGLATI", 640), ("LONGLATI", 1280)):
    focal, middle = (200, 319.5) if name == "PERSPECTIVE" else (n / np.pi, 0)
    options = {"newSize": (n, n), "Knew": np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])}
    pose = np.zeros((3, 1)), np.array([[-baseline], [0], [0]])
    flag = getattr(cv2.omnidir, f"RECTIFY_{name}")
    disparity, _, _, cloud = cv2.omnidir.stereoReconstruct(
        *pair, K, D, xi, K, D, xi, *pose, flag, 64, 5, pointType=cv2.omnidir.XYZ, **options
    )
    count, cloud = np.sum(disparity > 0), cloud.reshape(-1, 3).astype(float)
    kept = disparity.T > 15  # points come column by column
    assert len(cloud) == kept.sum()
    d, column = disparity.T[kept] / focal, np.nonzero(kept)[0] / focal
    if name == "PERSPECTIVE":
        ratio = cloud[:, 2] / (baseline / d)
    else:  # rays at angles of `column` and `column - d` from the baseline
        ratio = np.linalg.norm(cloud, axis=1) / (baseline * np.sin(column - d) / np.sin(d))
    found[name, n] = len(cloud) / count, ratio.max()
    print(f"{name:11} {n:4} px: {count:7} pixels with a disparity, {len(cloud):6} points; distance by where "
          f"their own rays meet: median {np.median(ratio):.3f}, at most {ratio.max():.2f}")
    if name == "PERSPECTIVE":
        print(f"the front wall is 4 m away; the farthest point lies {cloud[:, 2].max():.2f} m in front")
        assert abs(ratio - 1).max() < 1e-3 and cloud[:, 2].max() < 200 * baseline / 15
assert found["PERSPECTIVE", 640][0] < 0.7 and found["LONGLATI", 640][0] < 0.2
assert found["LONGLATI", 640][1] > 1.15 and found["LONGLATI", 1280][1] > 1.4
PY
