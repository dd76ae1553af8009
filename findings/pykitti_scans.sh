#!/usr/bin/env bash
# A KITTI drive without two of its scans: pykitti gives the images behind the gap the scans of two frames later.
# Guessed before: that a frame's scan is found by its number, or that the gap is an error or None.
# Raw drives have such gaps: 2011_09_26_drive_0009 is published without the scans 177 to 180.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" pykitti==0.3.1 numpy==2.4.6 pillow==12.0.0 opencv-python-headless==5.0.0.93
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
from importlib.metadata import version
from pathlib import Path
import numpy as np, pykitti
from PIL import Image
day = Path("2011_09_26")
folders = "image_00", "image_01", "image_02", "image_03", "velodyne_points", "oxts"
for name in folders:
    folder = day / "2011_09_26_drive_0009_sync" / name
    (folder / "data").mkdir(parents=True)
    (folder / "timestamps.txt").write_text("".join(f"2011-09-26 13:02:25.{k}00000000\n" for k in range(8)))
    for k in range(8):  # pixels and points hold the number of their frame
        file = folder / f"data/{k:010}"
        if name == "oxts":
            file.with_suffix(".txt").write_text("49.0 8.4 110 " + "0 " * 22 + "4 9 4 4 0\n")
        elif name != "velodyne_points":
            Image.fromarray(np.full((4, 6), k, np.uint8)).save(file.with_suffix(".png"))
        elif k not in (3, 4):
            np.full((1, 4), k, "<f4").tofile(file.with_suffix(".bin"))
rigid = "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n"
cameras = "".join(f"R_rect_0{n}: 1 0 0 0 1 0 0 0 1\nP_rect_0{n}: 700 0 3 0 0 700 2 0 0 0 1 0\n" for n in range(4))
for name, text in (("imu_to_velo", rigid), ("velo_to_cam", rigid), ("cam_to_cam", cameras)):
    (day / f"calib_{name}.txt").write_text(text)

def frames(**chosen):
    drive = pykitti.raw(".", "2011_09_26", "0009", **chosen)
    return [(int(np.asarray(drive.get_cam0(k))[0, 0]), int(drive.get_velo(k)[0, 0])) for k in range(min(len(drive), 6))]

print("pykitti", version("pykitti"), "frame of the image, of the scan; the scans of 3 and 4 are missing")
whole, part = frames(), frames(frames=range(2, 6))
print("all:        ", whole)
print("frames 2–5: ", part)
assert whole == [(0, 0), (1, 1), (2, 2), (3, 5), (4, 6), (5, 7)]
assert part == [(2, 2), (3, 5), (4, 6), (5, 7)]
PY
