#!/usr/bin/env bash
# The smallest of sixteen costs, the last of which is unknown: OpenVINO says 3.4e38.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" numpy==2.4.6 onnxruntime==1.32.0 onnx==1.23.2 openvino==2026.4.1
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import numpy as np, onnxruntime, openvino
from onnx import TensorProto, helper
core, costs = openvino.Core(), np.linspace(0.9, 0.1, 16, dtype=np.float32)
costs[8] = 0.01
def both(op, values, **attributes):
    kind = TensorProto.INT64 if op == "ArgMin" else TensorProto.FLOAT
    ends = [helper.make_tensor_value_info(*end) for end in (("x", 1, values.shape), ("y", kind, None))]
    graph = helper.make_graph([helper.make_node(op, ["x"], ["y"], **attributes)], "g", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10).SerializeToString()
    vino = core.compile_model(core.read_model(model), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})([values])[0]
    return onnxruntime.InferenceSession(model).run(None, {"x": values})[0].ravel()[0], vino.ravel()[0]
print("NaN at: onnxruntime", onnxruntime.__version__, "| openvino", openvino.__version__[:8])
found = {}
for hole in (0, 1, 15):
    holed = costs.copy()
    holed[hole] = np.nan
    for op in ("ReduceMin", "ArgMin"):
        found[op, hole] = both(op, holed[None], **({"axis": 1} if op == "ArgMin" else {"keepdims": 0}))
        print(f"{op} {hole}:", *(f"{value:g}" for value in found[op, hole]))
found["MaxPool"] = both("MaxPool", np.array([[[[0, 1], [4, np.nan]]]], np.float32), kernel_shape=[2, 2])
print("MaxPool of 0 1 4 NaN:", *found["MaxPool"])
smallest = np.float32(0.01)
assert np.isnan(found["ReduceMin", 0][0]) and found["ReduceMin", 0][1] == smallest
assert found["ReduceMin", 15][0] == smallest and found["ReduceMin", 15][1] > 3e38
assert found["ArgMin", 0] == (0, 8) and found["ArgMin", 1] == (8, 8) and found["ArgMin", 15] == (8, 15)
assert np.isnan(found["MaxPool"][0]) and found["MaxPool"][1] == 4
PY
