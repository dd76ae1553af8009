#!/usr/bin/env bash
# `principal_point_offset_x=.1` of Mitsuba moves the principal point to the left, and `_y` upwards.
# Guessed before: that the "position of the camera's principal point relative to the center of the film" (its pages)
# counts to the right and down, as the rows and columns of its image do.
set -euo pipefail
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
python3 -m pip install --quiet --no-compile --root-user-action ignore --target "$site" mitsuba==3.9.1 numpy==2.4.6
cd "$site" && PYTHONPATH=$site python3 - <<'PY'
import mitsuba as mi, numpy as np
mi.set_variant("scalar_rgb")
T = mi.ScalarTransform4f
width, height, focal = 80, 60, 40  # 90° wide

def axis(x, y):
    """Return the column and row, from the image's corner, where a wall 2 m in front has x = y = 0."""
    scene = {
        "type": "scene",
        "integrator": {"type": "aov", "aovs": "place:position"},
        "wall": {"type": "rectangle", "to_world": T().look_at([0, 0, 2], [0, 0, 0], [0, -1, 0]).scale(50)},
        "sensor": {
            "type": "perspective", "fov": 90, "fov_axis": "x",
            "principal_point_offset_x": x, "principal_point_offset_y": y,
            "to_world": T().look_at([0, 0, 0], [0, 0, 1], [0, -1, 0]),  # x right, y down, looks along z
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 256},
        },
    }
    place = np.array(mi.render(mi.load_dict(scene)))[..., -3:-1]  # x and y of the wall, metres
    slope = np.gradient(place[..., 0], axis=1).mean(), np.gradient(place[..., 1], axis=0).mean()
    assert np.allclose(slope, 2 / focal, rtol=0.01)  # to the right x grows, downwards y
    return width / 2 - place[..., 0].mean() / slope[0], height / 2 - place[..., 1].mean() / slope[1]

found = {offset: np.round(axis(*offset), 1) for offset in ((0, 0), (0.1, 0), (0, 0.1))}
for offset, (column, row) in found.items():
    print(f"Mitsuba {mi.__version__} offset {offset}: the axis is at column {column} of {width}, row {row} of {height}")
expected = {(0, 0): (40, 30), (0.1, 0): (32, 30), (0, 0.1): (40, 24)}  # it would be 48, and 36
assert all(np.allclose(found[offset], expected[offset], atol=0.2) for offset in found)
PY
