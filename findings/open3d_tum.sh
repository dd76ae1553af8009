#!/usr/bin/env bash
# A trajectory that Open3D writes in the format of TUM loses its first pose, which ends up on the line of the comment.
# Guessed before: that all five poses come back, in Open3D itself at the least.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" open3d==0.20.0 evo==1.38.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, open3d
from evo.tools import file_interface
poses = [open3d.camera.PinholeCameraParameters() for _ in range(5)]
for k, pose in enumerate(poses):  # camera k is k metres to the right
    pose.intrinsic = open3d.camera.PinholeCameraIntrinsic(640, 480, 500, 500, 319.5, 239.5)
    pose.extrinsic = np.block([[np.eye(3), np.array([[-k], [0], [0]])], [np.zeros(3), 1]])
trajectory = open3d.camera.PinholeCameraTrajectory()
trajectory.parameters = poses
assert open3d.io.write_pinhole_camera_trajectory("poses.txt", trajectory)
print("open3d", open3d.__version__, "writes five poses in poses.txt:")
print(open("poses.txt").read())
read = open3d.io.read_pinhole_camera_trajectory("poses.txt").parameters
found = {
    "Open3D": [float(-pose.extrinsic[0, 3]) for pose in read],
    "evo 1.38.1": file_interface.read_tum_trajectory_file("poses.txt").positions_xyz[:, 0].tolist(),
    "numpy.loadtxt": np.loadtxt("poses.txt")[:, 1].tolist(),
}
for name, places in found.items():
    print(f"{name:13} reads cameras at {places} metres")
    assert places == [1, 2, 3, 4]
# What follows: by number, each image has the pose of the next one.
open3d.io.write_pinhole_camera_trajectory("poses.log", trajectory)
assert len(open3d.io.read_pinhole_camera_trajectory("poses.log").parameters) == 5
print("as poses.log all five come back")
PY
