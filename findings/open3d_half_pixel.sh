#!/usr/bin/env bash
# Depth that Open3D casts, and the cloud that it makes of it with the same intrinsics, are half a pixel apart.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" open3d==0.20.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, open3d
from open3d.core import Tensor
matrix = Tensor(np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]]))
scene = open3d.t.geometry.RaycastingScene()
wall = open3d.t.geometry.TriangleMesh.create_box(1000, 1000, 1).translate([-500, -500, 2.0])
scene.add_triangles(wall)
rays = scene.create_rays_pinhole(matrix, Tensor(np.eye(4)), 64, 48)
depth = scene.cast_rays(rays)["t_hit"].numpy()
hit = (rays.numpy()[..., :3] + depth[..., None] * rays.numpy()[..., 3:]).reshape(-1, 3)
image = open3d.t.geometry.Image(depth.astype(np.float32))
cloud = open3d.t.geometry.PointCloud.create_from_depth_image(image, matrix, depth_scale=1.0)
off = 100 / 2 * (hit - cloud.point.positions.numpy())
print("open3d", open3d.__version__, "first ray hits", hit[0], "first point", cloud.point.positions.numpy()[0])
print("pixels between them:", off.mean(0))
assert np.allclose(off, [0.5, 0.5, 0], atol=1e-3)
PY
