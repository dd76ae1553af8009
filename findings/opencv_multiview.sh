#!/usr/bin/env bash
# Exact corners of three fisheyes: calibrateMultiview finds the rig from (1, N, 2) with CALIB_RECOMPUTE_EXTRINSIC.
# In the shapes (N, 2) and (N, 1, 2), in which OpenCV's detectors return corners, it stops with an error about array
# operations; without the flag it returns a rig whose error is a hundred pixels. Pinholes take (N, 2) and no flag.
# Guessed before: that what serves pinholes serves CALIB_MODEL_FISHEYE.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --no-deps --target "$site" numpy==2.4.6 opencv-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np
print("OpenCV", cv2.__version__)
rng = np.random.default_rng(1)
K, zero, frames = np.array([[220.0, 0, 320], [0, 220, 240], [0, 0, 1]]), np.zeros(3), 25
board = np.zeros((54, 3), np.float32)
board[:, :2] = 0.1 * np.mgrid[:9, :6].T.reshape(-1, 2)
turn = lambda *axis: cv2.Rodrigues(np.array(axis, float))[0]
poses = [(turn(0, 0.35 * k, 0), np.array([-0.3 * k, 0.01 * k, 0.03 * k])) for k in range(3)]

def corners(model):
    found, mask = [[], [], []], np.zeros((3, frames), np.uint8)
    for frame in range(frames):
        around = rng.uniform(-0.6, 1.2)
        centre = [1.2 * np.sin(around) - 0.4, rng.uniform(-0.5, 0.3), 1.2 * np.cos(around)]
        points = board @ (turn(0, around, 0) @ turn(*rng.uniform(-0.5, 0.5, 3))).T + centre
        for k, (R, t) in enumerate(poses):
            seen = points @ R.T + t
            if model == cv2.CALIB_MODEL_FISHEYE:
                lens = np.array([0.03, -0.01, 0.004, -0.001])
                pixels = cv2.fisheye.projectPoints(seen[:, None], zero, zero, K, lens)[0][:, 0]
            else:
                pixels = cv2.projectPoints(seen, zero, zero, K, np.array([-0.1, 0.02, 0, 0, 0]))[0][:, 0]
            mask[k, frame] = seen[:, 2].min() > 0.2 and (pixels >= 0).all() and (pixels < [640, 480]).all()
            found[k].append(pixels.astype(np.float32) if mask[k, frame] else np.zeros((0, 2), np.float32))
    return found, mask

def calibrate(model, seen, shape, flags):
    found, mask = seen
    shaped = [[pixels.reshape(shape) for pixels in camera] for camera in found]
    kind = np.full(3, model, np.uint8), None, None, None, None
    try:
        rms, *_, Ts = cv2.calibrateMultiview([board] * frames, shaped, [(640, 480)] * 3, mask, *kind,
                                             flagsForIntrinsics=np.full(3, flags, np.int32))
        return rms, float(np.linalg.norm(np.ravel(Ts[2]) - poses[2][1]))
    except cv2.error as error:
        return error.err.split(".")[0][:60]

fisheye, pinhole = cv2.CALIB_MODEL_FISHEYE, cv2.CALIB_MODEL_PINHOLE
of_fisheye, recompute, answers = corners(fisheye), cv2.CALIB_RECOMPUTE_EXTRINSIC, []
for seen, *how in (
    (corners(pinhole), pinhole, (-1, 2), 0),
    (of_fisheye, fisheye, (-1, 2), recompute),
    (of_fisheye, fisheye, (-1, 1, 2), recompute),
    (of_fisheye, fisheye, (1, -1, 2), recompute),
    (of_fisheye, fisheye, (1, -1, 2), 0),
):
    answers.append(calibrate(how[0], seen, *how[1:]))
    named = "fisheye" if how[0] == fisheye else "pinhole", how[1], "CALIB_RECOMPUTE_EXTRINSIC" if how[2] else "no flag"
    print(*named, "→", answers[-1] if isinstance(answers[-1], str) else "rms {:.3g} px, camera 3 off by {:.3g} m".format(*answers[-1]))
flat, of_detectors = answers[1:3]
assert answers[0][0] < 1e-3 and answers[3][0] < 1e-3 and answers[3][1] < 1e-3
assert isinstance(flat, str) and isinstance(of_detectors, str) and answers[4][0] > 10
PY
