#!/usr/bin/env bash
# Float depth through FFmpeg: scale and v360 read a float PFM, write a float PFM, and leave nothing beyond 1 m.
# Guessed before: that from float to float a resize, above all one to the nearest, keeps values beyond 1; crop, hflip and zscale do.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" av==18.1.0 imageio-ffmpeg==0.8.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import subprocess
import av, imageio_ffmpeg, numpy as np
depth = np.tile(np.linspace(0.5, 19.5, 64, dtype="<f4"), (32, 1))  # metres, a panorama
open("depth.pfm", "wb").write(b"Pf\n64 32\n-1.0\n" + depth[::-1].tobytes())
def filtered(name):
    call = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "warning", "-i", "depth.pfm", "-vf", name]
    done = subprocess.run([*call, "-frames:v", "1", "-update", "1", "out.pfm"], capture_output=True, text=True, check=True)
    kind, size, scale, data = open("out.pfm", "rb").read().split(b"\n", 3)
    channels, order = (3 if kind == b"PF" else 1), ("<f4" if float(scale) < 0 else ">f4")
    values = np.frombuffer(data, order).reshape(*map(int, size.split()[::-1]), channels)
    return values[::-1, :, 0], done.stderr.strip()
print("FFmpeg", imageio_ffmpeg.get_ffmpeg_version(), "| a depth of 0.5 to 19.5 m, as floats")
found = {}
for name in ("hflip", "crop=64:16", "zscale=128:64", "scale=128:64", "scale=128:64:flags=neighbor", "v360=e:e", "pad=80:40"):
    values, said = filtered(name)
    found[name] = values[8, 1], values.max(), values[8, values.shape[1] // 2]
    print(f"{name:28} second pixel {found[name][0]:7.4f}, largest {found[name][1]:7.4f}, in the middle {found[name][2]:.5f} {said}")
    assert not said
with av.open("depth.pfm") as container:
    frame = next(container.decode(video=0))
resized = frame.reformat(width=128, height=64).to_ndarray()
print("PyAV", av.__version__, "reformat from", frame.format.name, "to", resized.dtype, "largest", resized.max())
assert all(found[name][1] > 19 for name in ("hflip", "crop=64:16", "zscale=128:64"))
assert all(found[name][1] < 1.001 for name in list(found)[3:]) and found["v360=e:e"][2] < 0.001
assert abs(found["v360=e:e"][0] - 0.929) < 0.001  # of 0.802 m
assert frame.format.name == "grayf32le" and resized.dtype == np.float32 and resized.max() < 1.001
PY
