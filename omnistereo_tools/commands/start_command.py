"""From your own pictures to depth: calibrate, check the rig, and compute, in one command.

FOLDER/boards has one folder of images of a board per camera, such as cam1 to cam4; images taken
at one moment share a name. FOLDER/scene has one image of the scene per camera, named as the
folders: cam1.jpg, … What comes out is FOLDER/rig and FOLDER/depth.

Examples:
  omnistereo start my_rig --board 12x10 --square 0.06 --max-fov 220
"""

from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import MISSING, dataclass
from functools import partial
from io import StringIO
from pathlib import Path

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands import calibrate_command, depth_command, doctor_command
from omnistereo_tools.commands.calibrate_command import CalibrateOptions
from omnistereo_tools.commands.depth_command import DepthOptions
from omnistereo_tools.commands.options import DoctorOptions, LensOptions
from omnistereo_tools.parser import option

_PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, kw_only=True)
class StartOptions(LensOptions):
    """Options of `omnistereo start`."""

    folder: Path = option("with boards/ and scene/", MISSING, positional=True, metavar="FOLDER")
    board: str = option("inner corners, columns x rows, such as 12x10, or a YAML file", MISSING)
    max_fov: float | None = option(
        "full field of view", unset="as far as corners reach", metavar="DEGREES"
    )
    square: float | None = option("edge of a square in metres, such as 0.06", needs="board")


def run(options: StartOptions) -> int:
    """Calibrate, check and compute, with a verdict each; return 1 if the rig does not fit."""
    boards, rig = options.folder / "boards", options.folder / "rig"
    images = _scene(options.folder / "scene", boards)
    calibrate = CalibrateOptions(
        folder=boards, board=options.board, square=options.square, max_fov=options.max_fov, out=rig
    )
    _say("Rig", partial(calibrate_command.run, calibrate))
    file, out = rig / "config.yaml", options.folder / "depth"
    if _say("Check", partial(doctor_command.run, DoctorOptions(rig=file, images=images))):
        return 1
    _say("Depth", partial(depth_command.run, DepthOptions(rig=file, images=images, out=out)))
    print(out / "index.html")
    return 0


def _say(step: str, run: Callable[[], int]) -> int:
    """Run a command, print its verdict, or all that it says if it fails, and return its status."""
    with redirect_stdout(StringIO()) as said:
        status = run()
    verdict, *more = said.getvalue().splitlines()
    told = more if status else [line for line in more if line.startswith("Hold the board next")]
    print(f"{step}: {' '.join(verdict.split())}", *told, sep="\n", flush=True)
    return status


def _scene(scene: Path, boards: Path) -> tuple[Path, ...]:
    """Return the picture of the scene of each camera, in the order of the folders of boards."""
    if not boards.is_dir() or not scene.is_dir():
        missing = next(folder for folder in (boards, scene) if not folder.is_dir())
        raise OmnistereoError(
            f"{missing} is missing. Put images of the board into {boards}/cam1/, cam2/, …, by"
            f" one name those of one moment, and one of the scene per camera into {scene}/:"
            " cam1.jpg, cam2.jpg, …"
        )
    from omnistereo_lib.pictures import find_pictures
    from omnistereo_rigs.boards.captures import find_captures

    pictures = find_pictures(scene, _PICTURES)
    names = find_captures(boards).cameras
    if missing_names := [name for name in names if name not in pictures]:
        raise OmnistereoError(
            f"{scene} has no image of {', '.join(missing_names)}; found"
            f" {', '.join(path.name for path in pictures.values()) or 'none'}. Name each as the"
            f" folder of its camera in {boards}"
        )
    return tuple(pictures[name] for name in names)
