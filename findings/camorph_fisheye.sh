#!/usr/bin/env bash
# A rig that camorph turns from COLMAP's files into a transforms.json: its fisheyes are pinholes there, k4 is lost, numbers
# within .001 of the first camera's become the first camera's, and of FULL_OPENCV k3 stands in the place of k2.
# Guessed before: that `camera_model` and all numbers of each lens are written, or that it refuses, as it does into COLMAP's.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" camorph==1.0.0 pycolmap==4.2.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 -W ignore - <<'PY'
import json
from importlib.metadata import version
from pathlib import Path
import numpy as np, pycolmap
from PIL import Image
import camorph.camorph as camorph
rig, angles = Path("rig").absolute(), (20, 40, 60, 80)
lenses = {
    1: "OPENCV_FISHEYE 800 768 200 200 400 384 0.02 -0.004 0.0005 -0.0001",
    2: "OPENCV_FISHEYE 800 768 210 210 390 380 0.03 -0.006 0.0009 -0.0002",
    3: "OPENCV 800 768 400 400 400 384 0.1 0.2 0.001 0.002",
    4: "FULL_OPENCV 800 768 400 400 400 384 0.1 0.2 0 0 0.3 0 0 0",
}
model = rig / "sparse/0"
for folder in (model, rig / "images", rig / "back"):
    folder.mkdir(parents=True)
for n in lenses:
    Image.new("L", (800, 768)).save(rig / f"images/{n}.png")
(model / "cameras.txt").write_text("".join(f"{n} {lens}\n" for n, lens in lenses.items()))
(model / "images.txt").write_text("".join(f"{n} 1 0 0 0 {n} 0 0 {n} {n}.png\n\n" for n in lenses))
(model / "points3D.txt").touch()

cameras = camorph.read_cameras("COLMAP", str(model))
camorph.write_cameras("nerf", str(rig / "transforms.json"), cameras)
written = json.loads((rig / "transforms.json").read_text())
numbers = "fl_x fl_y cx cy k1 k2 k3 k4 p1 p2".split()
print("camorph", version("camorph"), "writes", [key for key in written if key != "frames"])
for n, frame in enumerate(written["frames"], 1):
    frame |= written | frame["intrinsics"]  # what is not stated of a frame is that of the whole file
    print(f"{n} was {lenses[n]}\n    is", *(f"{key} {frame[key]}" for key in numbers if key in frame))
assert not {"camera_model", "k4"} & (written.keys() | written["frames"][1].keys())
assert [written["frames"][n][key] for n, key in ((1, "k3"), (2, "p1"), (3, "k2"))] == [0.0005, 0, 0.3]

camorph.write_cameras("COLMAP", str(rig / "back"), camorph.read_cameras("nerf", str(rig / "transforms.json")), file_type="txt")
row = (rig / "back/cameras.txt").read_text().splitlines()[3].split()
true = pycolmap.Camera(model="OPENCV_FISHEYE", width=800, height=768, params=[*map(float, lenses[1].split()[3:])])
back = pycolmap.Camera(model=row[1], width=800, height=768, params=[*map(float, row[4:])])
rays = np.column_stack([np.sin(np.radians(angles)), np.zeros(4), np.cos(np.radians(angles))])
found = [float(np.degrees(np.arctan(back.cam_from_img(true.img_from_cam(ray[None]))[0, 0]))) for ray in rays]
print(f"and back in COLMAP: {row[1]}; what lay at {angles}° lies at {np.round(found, 1).tolist()}°")
assert row[1] == "FULL_OPENCV" and np.all(np.array(found[1:]) < (36, 48, 58))
PY
