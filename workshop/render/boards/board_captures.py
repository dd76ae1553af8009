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

from omnistereo_lib.files import make_folder, write_text
from omnistereo_lib.pictures import is_whole
from workshop.render.boards.positions import (
    COLUMNS,
    ROWS,
    SQUARE,
    Capture,
    CaptureSet,
    plan_captures,
)
from workshop.render.camera.render_rig import RigCamera, make_rig, write_config

_BLUR_PX = 0.5  # of the lens, the standard deviation
_QUALITY = 75  # of the JPEG files: corners are found to 0.05 px as with 92, in a third of the space


def picture_path(folder: Path, number: int, camera: int) -> Path:
    """Return where the picture of a camera, counted from 1, lies."""
    return folder / f"cam{camera}" / f"{number:04d}.jpg"


def is_captured(folder: Path, captures: CaptureSet, number: int, seed: int) -> bool:
    """Return whether all pictures of a capture are there, and whole."""
    capture = plan_captures(captures, seed)[number - captures.first]
    return all(is_whole(picture_path(folder, number, camera)) for camera in capture.T_rig_board)


def write_truth(path: Path, captures: CaptureSet, seed: int) -> None:
    """Write what is known of a set as JSON, one line for each picture.

    `board` has the inner corners (columns, rows) and the square in metres. `captures` are in order;
    each has its `name` (the pictures are cam1/NAME.jpg and so on), its `mistake` or null, and its
    `views`: the `camera` from 1, and the pose `T_rig_board` (axis-angle in radians, metres; of a
    blurred board in the middle of the exposure).
    """
    entries = []
    for number, capture in enumerate(plan_captures(captures, seed), start=captures.first):
        views = ",\n   ".join(
            json.dumps(
                {"camera": camera, "T_rig_board": pose.as_vector().round(6).tolist()},
                separators=(",", ":"),
            )
            for camera, pose in capture.T_rig_board.items()
        )
        mistake = json.dumps(capture.mistake)
        entries.append(
            f'  {{"name": "{number:04d}", "mistake": {mistake}, "views": [\n   {views}]}}'
        )
    board = json.dumps({"corners": [COLUMNS, ROWS], "square": SQUARE})
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
    for camera in range(1, len(rig.cameras) + 1):
        make_folder(folder / f"cam{camera}")
    layout = {
        "img_fmt": "cam%d/%04d.jpg",
        "start": captures.first,
        "step": 1,
        "end": captures.shipped[-1],
    }
    write_config(folder / "config.yaml", rig, captures.size, layout)
    write_truth(folder / "truth.json", captures, seed)
    missing = [number for number in numbers if not is_captured(folder, captures, number, seed)]
    if not missing:
        return
    from workshop.render.boards.studio import Studio  # Blender: imported when it draws

    studio = Studio()
    for number in missing:
        capture = plan_captures(captures, seed)[number - captures.first]
        for camera in capture.T_rig_board:
            path = picture_path(folder, number, camera)
            if not is_whole(path):
                _write(
                    path,
                    _picture(
                        studio, rig.cameras[camera - 1], capture, camera, captures, [seed, number]
                    ),
                )
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
    light = np.mean(
        [
            studio.radiance(camera, capture.pose(number, m), captures, 4 * seed[1] + number)
            for m in moments
        ],
        0,
    )
    noise = np.random.default_rng([*seed, 31, number])
    return develop(
        soften(light, _BLUR_PX), camera.lens, camera.sensor, studio.exposure, True, noise
    )


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


def _write(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture under a temporary name, which a later run takes again, then rename it."""
    from PIL import Image

    temporary = path.with_name(f".{path.name}")
    Image.fromarray(picture).save(temporary, "JPEG", quality=_QUALITY, optimize=True)
    temporary.replace(path)
