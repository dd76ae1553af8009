#!/usr/bin/env bash
# aniposelib adjusts a rig that fits exactly, and makes it worse: k2, k3 and k4 of its fisheyes (k2, p1, p2 and k3 of
# pinholes) are 0 afterwards, fx and fy one number. With only_extrinsics=True the lenses stay.
# Guessed before: that a coefficient that is not adjusted keeps its value.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" aniposelib==0.8.0 jax==0.10.2 numba==0.68.1 numpy==2.4.6 pandas==3.1.1 scipy==1.17.1 opencv-contrib-python==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
import numpy as np
from aniposelib.cameras import Camera, CameraGroup, FisheyeCamera
matrix = [[200, 0, 320], [0, 202, 240], [0, 0, 1]]
# kind, distortion, and the points: half the width of their box in metres, its nearest side
lenses = ((FisheyeCamera, [0.05, -0.02, 0.01, -0.004], 3, 0.7), (Camera, [-0.3, 0.12, 0.002, -0.001, -0.02], 2, 2))
print("aniposelib", version("aniposelib"), "fx 200, fy 202; mean error before → after, distortion, focal lengths")
for kind, numbers, side, nearest in lenses:
    points = np.random.default_rng(0).uniform([-side, -side, nearest], [side, side, 5], (300, 3))

    def rig():
        return CameraGroup([kind(matrix, numbers, (640, 480), [0, 0.1 * k, 0], [-0.5 * k, 0, 0], k) for k in range(3)])

    seen = rig().project(points).reshape(3, -1, 2)
    for only_extrinsics in (False, True):
        group = rig()
        before = group.average_error(seen)
        after = group.bundle_adjust(seen, only_extrinsics=only_extrinsics, verbose=False)
        lens = group.cameras[0]
        focal, distortion = np.array(lens.get_focal_length(both=True)), lens.get_distortions()
        print(f"{kind.__name__}, only_extrinsics={only_extrinsics}: {before:.4f} → {after:.4f} px,", distortion.round(3), focal.round(1))
        if only_extrinsics:
            assert after < before + 1e-3 and np.allclose(distortion, numbers) and np.allclose(focal, [200, 202])
        else:
            assert not distortion[1:].any() and focal[0] == focal[1] and after > 10 * before
            assert kind is Camera or (before < 1e-6 and 0.1 < after < 0.15 and 235 < focal[0] < 245)
PY
