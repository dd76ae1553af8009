#!/usr/bin/env bash
# A mirror, which is no rotation: four libraries answer with four poses, two refuse.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" pycolmap==4.2.1 trimesh==5.2.0 scipy==1.17.1 pyquaternion==0.9.9 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np, pycolmap, pyquaternion, scipy, trimesh
from scipy.spatial.transform import Rotation
mirror = np.diag([1.0, -1.0, 1.0])  # an image axis turned up instead of down
calls = {
    f"cv2.Rodrigues {cv2.__version__}": lambda: cv2.Rodrigues(mirror)[0].ravel().round(3).tolist(),
    f"pycolmap.Rigid3d {pycolmap.__version__}": lambda: pycolmap.Rigid3d(
        np.hstack([mirror, np.zeros((3, 1))])
    ).matrix()[:, :3].round(3).tolist(),
    f"pycolmap.Rotation3d {pycolmap.__version__}": lambda: pycolmap.Rotation3d(mirror).quat.round(3).tolist(),
    f"trimesh {trimesh.__version__}": lambda: trimesh.transformations.quaternion_from_matrix(mirror).round(3).tolist(),
    f"scipy {scipy.__version__}": lambda: Rotation.from_matrix(mirror).as_rotvec().tolist(),
    "pyquaternion 0.9.9": lambda: list(pyquaternion.Quaternion(matrix=mirror)),
}
found = []
for name, call in calls.items():
    try:
        found.append(call())
    except ValueError as error:
        found.append(None)
        print(f"{name:28} refused: {str(error).splitlines()[0][:70]}")
    else:
        print(f"{name:28} {found[-1]}")
rodrigues, rigid, quaternion, of_trimesh, of_scipy, of_pyquaternion = found
assert rodrigues == [1.111, 0, 1.111] and rigid == np.eye(3).tolist()
assert quaternion == [0, 0, 0, 0.707] and of_trimesh == [0, 1, 0, 0]  # one of length 0.7; a turn by 180° about x
assert of_scipy is None and of_pyquaternion is None
PY
