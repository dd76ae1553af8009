#!/usr/bin/env bash
# A NaN in a calibration that OpenCV writes: text in PyYAML and ruamel, and JSON that no JSON parser takes.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" opencv-python-headless==5.0.0.93 PyYAML==6.0.3 ruamel.yaml==0.18.16 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import io, json
import cv2, numpy as np, ruamel.yaml, yaml
errors = np.array([[0.21, np.nan, np.inf]])  # px of each view; the second one was left out
for suffix in ("yaml", "json"):
    storage = cv2.FileStorage(f"c.{suffix}", cv2.FILE_STORAGE_WRITE)
    storage.write("errors", errors)
    storage.release()
    storage.open(f"c.{suffix}", cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("errors").mat(), errors, equal_nan=True)
text = open("c.yaml").read().replace("!!opencv-matrix", "")  # the tag, which every reader has to know
found = {f"PyYAML {yaml.__version__}": yaml.safe_load(text)["errors"]["data"]}
found[f"ruamel.yaml {ruamel.yaml.__version__}"] = ruamel.yaml.YAML(typ="safe").load(io.StringIO(text))["errors"]["data"]
for name, values in found.items():
    print(f"cv2 {cv2.__version__} → {name}: {values}")
    assert values[1] == ".Nan" and values[2] == np.inf
try:
    json.load(open("c.json"))
except ValueError as error:
    print("→ json:", error)
else:
    raise AssertionError("json reads it")
PY
