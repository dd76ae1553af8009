#!/usr/bin/env bash
# Four clips of one recording, cut at .7 s without encoding: MP4 begins with frame 7, MKV with 5, and readers count 13 or 15.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" av==18.1.0 opencv-python-headless==5.0.0.93 decord==0.6.0 imageio-ffmpeg==0.8.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import subprocess
import av, cv2, decord, imageio_ffmpeg, numpy as np
def number(frame):
    return round((float(frame[32, 32].mean()) - 20) / 10)  # each frame is as bright as its number says
for path in ("whole.mp4", "whole.ts"):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"bf": "2", "g": "5"})
        stream.width = stream.height = 64
        for k in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 10 * k + 20, np.uint8), "rgb24")
            frame.pts = k
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
for path in ("cut.mp4", "cut.mkv"):
    cut = ["-loglevel", "error", "-ss", "0.7", "-i", "whole.mp4", "-c", "copy", path]
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *cut], check=True)
print("cv2", cv2.__version__, "PyAV", av.__version__, "decord", decord.__version__, "| first frame, number of frames")
found = {}
for path in ("cut.mp4", "cut.mkv", "whole.ts"):
    with av.open(path) as container:
        of_av = [number(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]
    video = cv2.VideoCapture(path)
    stated, of_opencv = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), []
    while (read := video.read())[0]:
        of_opencv.append(number(read[1]))
    reader = decord.VideoReader(path)
    of_decord = [number(reader[k].asnumpy()) for k in range(len(reader))]
    found[path] = [(rows[0], len(rows)) for rows in (of_av, of_opencv, of_decord)] + [stated]
    print(f"{path:9} PyAV {found[path][0]}  cv2 {found[path][1]}, stated {stated}  decord {found[path][2]}")
assert found["cut.mp4"] == [(7, 13), (7, 13), (7, 15), 15] and found["cut.mkv"] == [(5, 15), (5, 15), (5, 15), 15]
assert found["whole.ts"] == [(0, 20), (0, 20), (5, 20), 20]
PY
