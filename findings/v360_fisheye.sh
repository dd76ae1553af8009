#!/usr/bin/env bash
# FFmpeg's v360 with `ih_fov=220` takes a round fisheye of 220° for one of 220° × 180°, and paints what no lens sees
# in the colour of the picture's first pixel.
# Guessed before: that a field stated in one direction holds in the other, and that what is not seen is black.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" imageio-ffmpeg==0.8.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import subprocess
import imageio_ffmpeg, numpy as np
size, degrees = 800, (np.arange(720) + 0.5) / 2 - 180
def panorama(picture, options):
    raw = ["-f", "rawvideo", "-pix_fmt", "gray16le"]
    call = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", *raw, "-s", f"{size}x{size}", "-i", "-"]
    call += ["-vf", f"v360={options}:output=e:w=720:h=360", *raw, "-"]
    out = subprocess.run(call, input=picture.astype("<u2").tobytes(), stdout=subprocess.PIPE, check=True).stdout
    return np.frombuffer(out, "<u2").reshape(360, 720).astype(float)
ramp = np.tile(64 * np.arange(size), (size, 1))  # each pixel holds its column
def shown_at(options, pixel):
    halves = panorama(ramp, options)[180, 360:540], panorama(ramp.T, options)[180:, 360]  # from the middle to 90°
    return [round(float(np.interp(64 * pixel, half[half > 0], degrees[360:540][half > 0])), 1) for half in halves]
print("FFmpeg", imageio_ffmpeg.get_ffmpeg_version(), "| a point 30° to the right, one 30° down, come out at")
fisheye, flat = (size - 1) / 2 + 30 / 110 * size / 2, (size - 1) / 2 + np.tan(np.radians(30)) * size / 2
found = {}
for lens, pixel, fields in (
    ("fisheye", fisheye, ("ih_fov=220:iv_fov=220", "ih_fov=220", "iv_fov=220")),
    ("flat", flat, ("ih_fov=90:iv_fov=90", "ih_fov=90")),
):
    for field in fields:
        found[lens, field] = shown_at(f"input={lens}:{field}", pixel)
        print(f"input={lens}:{field:22}", found[lens, field])
wall = np.full((size, size), 20000)
wall[0, 0] = 5000
behind = panorama(wall, "input=fisheye:ih_fov=220:iv_fov=220")
print(f"a picture of 20,000 whose first pixel is 5,000: {np.mean(behind == 5000):.1%} of the panorama is 5,000")
for (lens, field), (right, down) in found.items():
    assert abs(right - (24.5 if field.startswith("iv") else 30)) < 0.2
    assert abs(down - (30 if "iv_fov" in field else 24.5 if lens == "fisheye" else 13.4)) < 0.3
assert behind[180, 0] == 5000 and 0.15 < np.mean(behind == 5000) < 0.2
PY
