"""A method of one's own: a Python file with a function `depth`, run in a process of its own.

    def depth(images, cameras, grid):
        '''Sphere indices (H, W), NaN where unknown; or a pair of them and confidences (H, W), 0 to
        1.'''

`course/exercises/one_file.py` is an example, with all that images, cameras and grid hold. The file
needs nothing of omnistereo, and what it does to its process harms nobody.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnistereo_lib.errors import OmnistereoError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omnistereo_lib.stereo.depth import Depth
    from omnistereo_lib.stereo.sweep import SphereSweep

RUNNER = Path(__file__).with_name("run_own.py")


@dataclass(frozen=True)
class Own:
    """What a method of one's own has found."""

    depth: Depth
    cpu_s: float  #: of `depth` alone, in all threads
    seconds: float  #: that passed
    judged: bool  #: whether it returned a confidence of its depths; else it counts as 1


def check_own(file: Path) -> None:
    """Refuse a file that cannot be a method: missing, no Python, or without `depth`."""
    from omnistereo_lib.files import read_text

    text = read_text(file)
    try:
        names = compile(text, str(file), "exec").co_names
    except (SyntaxError, ValueError) as error:
        line = f" in line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise OmnistereoError(f"{file} is not Python: {error.args[0]}{line}. Correct it") from None
    if "depth" not in names:
        raise _missing(file)


def _missing(file: Path) -> OmnistereoError:
    return OmnistereoError(
        f"{file} has no function `depth`; expected `def depth(images, cameras, grid)`, which"
        " returns sphere indices (H, W). The checkers write such a file once the functions of"
        " notebooks 01, 03, 04 and 05 are right"
    )


def run_own(
    file: Path,
    sweep: SphereSweep,
    images: Sequence[NDArray[Any]],
    start: Callable[..., int] | None = None,
) -> Own:
    """Run a method of one's own on the images of a frame.

    Args:
        start: Runs a command, and returns its exit status; default: a process like any other.

    Raises:
        OmnistereoError: If it stops, ends, or answers something else than `depth` has to.
    """
    with tempfile.TemporaryDirectory(prefix="own-") as name:
        folder = Path(name)
        _tell(folder, sweep, images)
        # -P: its modules are not those beside the runner.
        command = [sys.executable, "-P", str(RUNNER), str(file.resolve()), str(folder)]
        status = start(command) if start else subprocess.run(command, check=False).returncode
        return _read(file, folder, status, sweep, images)


def _tell(folder: Path, sweep: SphereSweep, images: Sequence[NDArray[Any]]) -> None:
    """Write what `run_own.inputs` reads."""
    import numpy as np

    from omnistereo_lib.geometry.rig import camera_pairs

    grid, rig, cameras = sweep.grid, sweep.rig, []
    arrays: dict[str, NDArray[Any]] = {}
    for k, (camera, pose, image) in enumerate(zip(rig.cameras, rig.T_rig_cam, images, strict=True)):
        arrays |= {f"image{k}": np.asarray(image), f"valid{k}": camera.visible_pixels()}
        facts = {
            "inv_poly": camera.inv_poly.tolist(),
            "poly": camera.poly.tolist(),
            "center": camera.center,
        }
        facts |= {
            "affine": camera.affine,
            "max_fov_deg": camera.max_fov_deg,
            "image_size": camera.image_size,
        }
        cameras.append(facts | {"R": pose.R.tolist(), "t": pose.t.tolist()})
    told: dict[str, Any] = {
        name: getattr(grid, name) for name in ("width", "height", "num_spheres", "min_depth")
    }
    told |= {"phi_deg": list(map(float, grid.phi_deg)), "pairs": camera_pairs("ring", rig)}
    (folder / "told.json").write_text(
        json.dumps({"cameras": cameras, "grid": told}), encoding="utf-8"
    )
    # Its hints take the names of the arrays for options.
    np.savez(folder / "images.npz", **arrays)  # type: ignore[arg-type]


def _read(
    file: Path, folder: Path, status: int, sweep: SphereSweep, images: Sequence[NDArray[Any]]
) -> Own:
    """Return what it has answered, or raise what is wrong with it."""
    import numpy as np

    from omnistereo_lib.files import read_data
    from omnistereo_lib.stereo.depth import Depth

    try:
        said = read_data(folder / "said.json")
    except OmnistereoError:
        raise OmnistereoError(
            f"{file} ended its process without an answer, {_status(status)}"
        ) from None
    if "error" in said:
        raise OmnistereoError(f"{file} stopped with {said['error']}")
    if said.get("missing"):
        raise _missing(file)
    shape, N = sweep.grid.shape, sweep.grid.num_spheres
    if "kind" in said or said["parts"] > 2:
        found = said.get("kind") or f"{said['parts']} things"
        raise OmnistereoError(
            f"depth of {file} returns {found}; expected sphere indices {shape}, or a pair: with"
            " confidences as many"
        )
    index = _array(file, folder, "index", shape, N - 1)
    if not np.isfinite(index).any():
        raise OmnistereoError(f"depth of {file} finds no ray's sphere: all its indices are NaN")
    if said["parts"] == 2:
        confidence = _array(file, folder, "confidence", shape, 1)
    else:
        confidence = np.where(np.isfinite(index), 1.0, np.nan)
    depth = Depth(index.astype(np.float32), confidence.astype(np.float32), sweep, images)
    return Own(depth, said["cpu_s"], said["seconds"], said["parts"] == 2)


def _array(
    file: Path, folder: Path, name: str, shape: tuple[int, int], most: float
) -> NDArray[np.float64]:
    """Return one of the arrays, within its range but for rounding."""
    import numpy as np

    array = np.load(folder / f"{name}.npy", allow_pickle=False)
    what = f"depth of {file} returns {name} of"
    if array.shape != shape:
        raise OmnistereoError(
            f"{what} shape {array.shape}; expected {shape}, the rows and columns of the grid"
        )
    low, high = np.nanmin(array, initial=0), np.nanmax(array, initial=0)
    if low < -0.5 or high > most + 0.5:
        raise OmnistereoError(
            f"{what} {low:g} to {high:g}; expected 0 to {most:g}, and NaN where it is unknown"
        )
    return np.clip(array, 0, most)


def _status(status: int) -> str:
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    return f"with exit status {status}"
