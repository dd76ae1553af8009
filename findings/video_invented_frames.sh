#!/usr/bin/env bash
# A video with a pause: imageio hands out 25 frames where 20 were recorded.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" av==18.1.0 imageio==2.38.1 imageio-ffmpeg==0.8.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import av, imageio.v3, numpy as np
found = {}
print("imageio", imageio.__version__, "PyAV", av.__version__)
for path in ("pause.mp4", "pause.mkv"):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width = stream.height = 64
        for k in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 10 * k + 20, np.uint8), "rgb24")
            frame.pts = k if k < 6 else k + 5  # half a second without frames
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with av.open(path) as container:
        recorded = sum(1 for _ in container.decode(video=0))
    found[path] = recorded, sum(1 for _ in imageio.v3.imiter(path, plugin="FFMPEG"))
    print(path, "PyAV:", found[path][0], "frames, imageio:", found[path][1])
assert found == {"pause.mp4": (20, 25), "pause.mkv": (20, 25)}, found
PY
