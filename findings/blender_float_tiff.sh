#!/usr/bin/env bash
# A float32 depth TIFF in Blender: 19 m are 1,038 m, since it is taken for sRGB; an EXR is right.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" bpy==5.0.1 tifffile==2026.3.3 OpenEXR==3.5.3
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import bpy, numpy as np, OpenEXR, tifffile
depth = np.linspace(1, 19, 12, dtype=np.float32).reshape(3, 4)
tifffile.imwrite("depth.tiff", depth)
header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
OpenEXR.File(header, {"RGB": depth[..., None].repeat(3, -1)}).write("depth.exr")
found = {}
for path, space in (("depth.tiff", None), ("depth.tiff", "Non-Color"), ("depth.exr", None)):
    image = bpy.data.images.load(path, check_existing=False)
    image.colorspace_settings.name = space or image.colorspace_settings.name
    found[path, space] = np.reshape(image.pixels[:], (3, 4, -1))[::-1, :, 0]
    print(f"Blender {bpy.app.version_string} {path:10} {image.colorspace_settings.name:20} 19 m is {found[path, space][-1, -1]:.1f}")
srgb = ((depth + 0.055) / 1.055) ** 2.4
assert np.allclose(found["depth.tiff", None], srgb, rtol=0.01)
assert np.array_equal(found["depth.tiff", "Non-Color"], depth) and np.allclose(found["depth.exr", None], depth)
PY
