#!/usr/bin/env bash
# KITTI-360's own scripts project into its fisheyes without the tangential distortion of its calibration files, and
# give what is more than 90° from the axis a negative depth.
# Guessed before: that they read all of what the files state, and that a point in the picture has a positive depth.
# Somebody asked about it: https://github.com/autonomousvision/kitti360Scripts/issues/95
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --no-deps --target "$site" kitti360scripts==1.0.0 numpy==2.4.6 PyYAML==6.0.3 opencv-contrib-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
from pathlib import Path
import cv2, numpy as np, yaml
from kitti360scripts.helpers.project import CameraFisheye
load = yaml.load
yaml.load = lambda text, Loader=yaml.SafeLoader: load(text, Loader)  # PyYAML before 6 needed none
# xi, k1, k2, p1, p2, gamma1, gamma2, u0, v0 as published, rounded
published = {
    2: [2.2134, 0.016798, 1.65488, 0.00042224, 0.00042462, 1336.32, 1335.79, 716.94, 705.76],
    3: [2.5535, 0.049370, 4.50685, 0.00134777, -0.0007034, 1485.44, 1484.95, 698.88, 698.15],
}
Path("calibration").mkdir()
Path("data_poses/2013_05_28_drive_0009_sync").mkdir(parents=True)
unmoved = "1 0 0 0 0 1 0 0 0 0 1 0"
Path("data_poses/2013_05_28_drive_0009_sync/poses.txt").write_text(f"1 {unmoved}\n2 {unmoved}\n")
Path("calibration/calib_cam_to_pose.txt").write_text("".join(f"image_0{k}: {unmoved}\n" for k in range(4)))
angles = np.radians([0, 30, 60, 85, 92])
up = np.radians(53)
points = 5 * np.stack([np.sin(angles) * np.cos(up), np.sin(angles) * np.sin(up), np.cos(angles)], 1)
print("kitti360scripts", version("kitti360scripts"), "OpenCV", cv2.__version__, "at", np.degrees(angles).round(), "degrees")
for k, (xi, k1, k2, p1, p2, gamma1, gamma2, u0, v0) in published.items():
    Path(f"calibration/image_0{k}.yaml").write_text(
        f"%YAML:1.0\n---\nmodel_type: MEI\ncamera_name: image_0{k}\nimage_width: 1400\nimage_height: 1400\n"
        f"mirror_parameters:\n   xi: {xi}\ndistortion_parameters:\n   k1: {k1}\n   k2: {k2}\n   p1: {p1}\n   p2: {p2}\n"
        f"projection_parameters:\n   gamma1: {gamma1}\n   gamma2: {gamma2}\n   u0: {u0}\n   v0: {v0}\n"
    )
    u, v, depth = CameraFisheye(".", cam_id=k).cam2image(points.T.copy())
    K, still = np.array([[gamma1, 0, u0], [0, gamma2, v0], [0, 0, 1]]), np.zeros(3)

    def opencv(*tangential):
        return cv2.omnidir.projectPoints(points[:, None], still, still, K, xi, np.array([k1, k2, *tangential]))[0][:, 0]

    off = np.linalg.norm(opencv(p1, p2) - np.stack([u, v], 1), axis=1)
    print(f"image_0{k}: pixels off", off.round(2), "depths", depth.round(1))
    np.testing.assert_allclose(opencv(0, 0), np.stack([u, v], 1), atol=1e-6)  # otherwise the same model
    assert (depth[:4] > 0).all() and depth[4] < 0
    assert 0 <= u[4] < 1400 and 0 <= v[4] < 1400  # it is in the picture
    np.testing.assert_allclose(off[[0, 3]], {2: [0, 0.45], 3: [0, 0.51]}[k], atol=0.01)
PY
