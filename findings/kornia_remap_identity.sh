#!/usr/bin/env bash
# kornia.geometry.transform.remap with the map of each pixel to itself gives another image.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" kornia==0.9.0 torch==2.13.0 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import kornia, torch
row = torch.arange(8.0).expand(1, 1, 8, 8)
y, x = (at.float()[None] for at in torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij"))
default = kornia.geometry.transform.remap(row, x, y)[0, 0, 3]
aligned = kornia.geometry.transform.remap(row, x, y, align_corners=True)[0, 0, 3]
print("kornia", kornia.__version__, "default:", [round(v, 2) for v in default.tolist()])
print("align_corners=True:", [round(v, 2) for v in aligned.tolist()])
# The map is scaled for corners at pixel centres, the sampler then takes them at the image's edges.
assert abs(default[6] - 6.36) < 0.01 and abs(default[7] - 3.5) < 0.01
assert torch.allclose(aligned, row[0, 0, 3])
PY
