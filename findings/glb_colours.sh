#!/usr/bin/env bash
# A GLB's vertex colours in 16 bits: MeshLab shows .263 for .216; through trimesh a GLB loses unlit and its camera.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" pymeshlab==2025.7.post1 trimesh==5.2.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import json, struct
import numpy as np, pymeshlab, trimesh
def write(path, code, kind, colors):
    parts = [np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4"), np.arange(3, dtype="<u4"), np.array(colors, kind)]
    data, views = b"", []
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": part.nbytes})
        data += part.tobytes()
    tree = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}], "bufferViews": views}
    tree |= {"nodes": [{"mesh": 0}, {"camera": 0}], "buffers": [{"byteLength": len(data)}]}
    tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    primitive = {"attributes": {"POSITION": 0, "COLOR_0": 2}, "indices": 1, "material": 0}
    tree |= {"meshes": [{"primitives": [primitive]}], "extensionsUsed": ["KHR_materials_unlit"]}
    tree["materials"] = [{"extensions": {"KHR_materials_unlit": {}}}]
    tree["accessors"] = [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}]
    tree["accessors"] += [{"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}]
    tree["accessors"] += [{"bufferView": 2, "componentType": code, "count": 3, "type": "VEC4", "normalized": code != 5126}]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(data), len(text), 0x4E4F534A)
    open(path, "wb").write(head + text + struct.pack("<II", len(data), 0x004E4942) + data)
found = {}
for name, code, kind, gray, full in (("float", 5126, "<f4", 0.21586, 1), ("16 bits", 5123, "<u2", 14147, 65535), ("8 bits", 5121, "u1", 55, 255)):
    write("c.glb", code, kind, [[gray] * 3 + [full]] * 3)
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("c.glb")
    found[name] = meshes.current_mesh().vertex_color_matrix()[0, 0]
    print(f"0.216 in {name:8} pymeshlab 2025.7.post1: {found[name]:.4f}")
trimesh.load("c.glb").export("back.glb")
content = open("back.glb", "rb").read()
tree = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
print("through trimesh", trimesh.__version__, "| extensions:", tree.get("extensionsUsed"), "| cameras:", tree.get("cameras"))
assert abs(found["16 bits"] - 0.2627) < 0.001 and all(abs(found[n] - 0.216) < 0.001 for n in ("float", "8 bits"))
assert "extensionsUsed" not in tree and "cameras" not in tree
PY
