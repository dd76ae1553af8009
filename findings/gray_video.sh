#!/usr/bin/env bash
# A gray camera's ramp in H.264 as PyAV writes gray: black to 16 is black, and 235 to 255 white, when it is read.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" av==18.1.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import av, cv2, numpy as np
ramp = np.tile(np.arange(256, dtype=np.uint8), (64, 1))
def read_back(path, codec, pixels, options):
    with av.open(path, "w") as container:
        stream = container.add_stream(codec, rate=10, options=options)
        stream.width, stream.height, stream.pix_fmt = 256, 64, pixels
        frame = av.VideoFrame.from_ndarray(ramp, "gray")
        frame.pts = 0
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with av.open(path) as container:
        yield next(container.decode(video=0)).to_ndarray(format="gray")[32]
    yield cv2.VideoCapture(path).read()[1][32, :, 0]
at = [0, 8, 16, 128, 235, 250]
print("PyAV", av.__version__, "cv2", cv2.__version__, "written", at)
kinds = (("libx264", "gray"), ("libx264", "yuv420p"), ("ffv1", "gray"))
found = {kind: list(read_back("g.mkv", *kind, {"qp": "0"} if kind[0] == "libx264" else {})) for kind in kinds}
for kind, rows in found.items():
    print(*kind, "→", *(row[at].tolist() for row in rows))
assert all(row[16] == 0 and row[235] == 255 for row in found["libx264", "gray"])
assert all(np.abs(row.astype(int) - ramp[0]).max() <= 2 for kind in kinds[1:] for row in found[kind])
PY
