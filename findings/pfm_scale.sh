#!/usr/bin/env bash
# A PFM whose header says scale 2: OpenCV and FFmpeg halve the depth, Pillow takes it as it is, imageio makes bytes.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" opencv-python-headless==5.0.0.93 av==18.1.0 pillow==13.0.0 imageio==2.38.1 imageio-ffmpeg==0.8.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import av, cv2, imageio.v3, numpy as np, PIL
from PIL import Image
depth = np.arange(1, 13, dtype=">f4").reshape(3, 4)
open("d.pfm", "wb").write(b"Pf\n4 3\n2.0\n" + depth[::-1].tobytes())
with av.open("d.pfm") as container:
    of_ffmpeg = next(container.decode(video=0)).to_ndarray()
found = {f"cv2 {cv2.__version__}": cv2.imread("d.pfm", cv2.IMREAD_UNCHANGED), f"PyAV {av.__version__}": of_ffmpeg}
found |= {f"Pillow {PIL.__version__}": np.array(Image.open("d.pfm"))}
found |= {f"imageio {imageio.__version__}": imageio.v3.imread("d.pfm")}
for name, values in found.items():
    print(f"{name:16}", values.dtype, values.shape, "first and last", values.flat[0], values.flat[-1])
of_opencv, of_av, of_pillow, of_imageio = found.values()
assert np.array_equal(of_opencv, depth / 2) and np.array_equal(of_av, depth / 2)
assert np.array_equal(of_pillow, depth) and of_imageio.dtype == np.uint8
PY
