#!/usr/bin/env bash
# Where a map says nowhere (NaN), remap gives NaN, or a pixel of the image that looks like any other.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 opencv-python-headless==5.0.0.93 scikit-image==0.26.0 onnxruntime==1.32.0 onnx==1.23.2 openvino==2026.4.1
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import cv2, numpy as np, onnxruntime, openvino, skimage
from onnx import TensorProto, helper
from skimage.transform import warp
image = np.arange(100, 164, dtype=np.float32).reshape(8, 8)
nowhere = np.full((1, 1), np.nan, np.float32)
found = {}
for flag in ("INTER_LINEAR", "INTER_NEAREST", "INTER_CUBIC"):
    value = cv2.remap(image, nowhere, nowhere, getattr(cv2, flag), borderMode=cv2.BORDER_REPLICATE)
    found[f"cv2 {cv2.__version__} {flag}"] = value[0, 0]
for mode in ("edge", "reflect", "wrap"):
    found[f"skimage {skimage.__version__} {mode}"] = warp(
        image, np.stack([nowhere, nowhere]), order=1, mode=mode, preserve_range=True
    )[0, 0]
shapes = {"x": [1, 1, 8, 8], "grid": [1, 1, 1, 2]}
values = [helper.make_tensor_value_info(k, TensorProto.FLOAT, s) for k, s in (*shapes.items(), ("y", None))]
node = helper.make_node("GridSample", ["x", "grid"], ["y"], mode="linear", padding_mode="zeros")
graph = helper.make_graph([node], "g", values[:2], values[2:])
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10).SerializeToString()
feed = {"x": image[None, None], "grid": np.full((1, 1, 1, 2), np.nan, np.float32)}
found[f"onnxruntime {onnxruntime.__version__} zeros"] = onnxruntime.InferenceSession(model).run(None, feed)[0].item()
core = openvino.Core()
run = core.compile_model(core.read_model(model), "CPU")
found[f"openvino {openvino.__version__[:8]} zeros"] = run(list(feed.values()))[0].item()
for name, value in found.items():
    print(f"{name:28} {value:g}")
linear, nearest, cubic, edge, reflect, wrap, runtime, vino = found.values()
assert np.isnan(linear) and nearest == cubic == 100 and np.isnan(edge) and reflect == wrap == 100
assert runtime == 25 and np.isnan(vino)
PY
