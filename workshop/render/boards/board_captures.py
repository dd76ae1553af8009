"""Calibration captures as files: images of one number from all cameras that see the whole board.

`boards` plans them, `studio` draws them. All that is known of a set is in its folder: the true rig
in `config.yaml`, boards and poses in `truth.json`; `positions.true_corners` projects their corners.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.files import write_text
from omnistereo_lib.pictures import is_whole
from workshop.render.boards import positions
from workshop.render.boards.positions import Capture, CaptureSet, plan_captures
from workshop.render.camera.render_rig import RigCamera, make_rig
from workshop.render.image_sets import begin_set, image_path, write_frame

_BLUR_PX = 0.5  # of the lens, the standard deviation
_QUALITY = 75  # of the JPEG files: corners are found to 0.05 px as with 92, in a third of the space


def is_captured(folder: Path, captures: CaptureSet, number: int, seed: int) -> bool:
    """Return whether all pictures of a capture are there, and whole."""
    capture = plan_captures(captures, seed)[number - captures.first]
    return all(is_whole(image_path(folder, number, camera)) for camera in capture.T_rig_board)


def write_truth(path: Path, captures: CaptureSet, seed: int) -> None:
    """Write what is known of a set as JSON, one line for each picture.

    `board` has the inner corners (columns, rows) and the square in metres. `captures` are in order;
    each has its `name` (the pictures are cam1/NAME.jpg and so on), its `mistake` or null, and its
    `views`: the `camera` from 1, and the pose `T_rig_board` (axis-angle in radians, metres; of a
    blurred board in the middle of the exposure).
    """
    entries = []
    for number, capture in enumerate(plan_captures(captures, seed), start=captures.first):
        poses = capture.T_rig_board.items()
        views = [{"camera": c, "T_rig_board": T.as_vector().round(6).tolist()} for c, T in poses]
        lines = ",\n   ".join(json.dumps(view, separators=(",", ":")) for view in views)
        known = f'"name": "{number:04d}", "mistake": {json.dumps(capture.mistake)}'
        entries.append(f'  {{{known}, "views": [\n   {lines}]}}')
    corners = [positions.COLUMNS, positions.ROWS]
    board = json.dumps({"corners": corners, "square": positions.SQUARE})
    text = f'{{"board": {board},\n "captures": [\n' + ",\n".join(entries) + "\n ]}\n"
    write_text(path, text)


def render_captures(
    folder: Path, captures: CaptureSet, numbers: tuple[int, ...], seed: int
) -> Iterator[int]:
    """Render the pictures that are missing; yields the number of each finished capture.

    Args:
        folder: Where the set is, or begins to be.
        numbers: Captures wanted.
        seed: Of the rig, the boards and the noise.
    """
    rig = make_rig(seed, captures.rig)
    begin_set(folder, rig, captures.size, captures.first, captures.shipped[-1])
    write_truth(folder / "truth.json", captures, seed)
    missing = [number for number in numbers if not is_captured(folder, captures, number, seed)]
    if not missing:
        return
    from workshop.render.boards.studio import Studio  # Blender: imported when it draws

    studio = Studio()
    for number in missing:
        capture = plan_captures(captures, seed)[number - captures.first]
        for camera in capture.T_rig_board:
            path, lens = image_path(folder, number, camera), rig.cameras[camera - 1]
            if not is_whole(path):
                picture = _picture(studio, lens, capture, camera, captures, [seed, number])
                write_frame([path], [picture], _QUALITY)
        yield number


def _picture(
    studio: object,
    camera: RigCamera,
    capture: Capture,
    number: int,
    captures: CaptureSet,
    seed: list[int],
) -> NDArray[np.uint8]:
    from workshop.render.camera.sensor import develop

    moments = np.linspace(-0.5, 0.5, 9) if capture.sway.any() else np.zeros(1)
    poses = [capture.pose(number, moment) for moment in moments]
    sampler = 4 * seed[1] + number
    light = np.mean([studio.radiance(camera, pose, captures, sampler) for pose in poses], 0)
    noise, soft = np.random.default_rng([*seed, 31, number]), soften(light, _BLUR_PX)
    return develop(soft, camera.lens, camera.sensor, studio.exposure, True, noise)


def soften(light: NDArray, sigma: float) -> NDArray[np.float64]:
    """Return a picture blurred by a Gaussian of `sigma` pixels; outside it is dark."""
    offsets = np.arange(-4, 5)
    weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        light = sum(
            weight * np.roll(light, offset, axis)
            for weight, offset in zip(weights, offsets, strict=True)
        )
    return light
