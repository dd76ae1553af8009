"""Convert a rig of any program into config.yaml, or a rig for another program; say what was
assumed.

Examples:
  omnistereo rig camchain.yaml rig.yaml
      any file or folder that is read, as config.yaml
  omnistereo rig rig.yaml half.yaml --size 400x384
      for images of another size
  omnistereo rig rig.yaml colmap --to colmap
      a folder for COLMAP, with masks
"""

from __future__ import annotations

import re
import shlex
import warnings
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.options import LensOptions
from omnistereo_tools.parser import option

if TYPE_CHECKING:
    from omnistereo_rigs.formats.read import RigReading


@dataclass(frozen=True, kw_only=True)
class RigFileOptions(LensOptions):
    """Options of `omnistereo rig`."""

    source: Path = option("rig file or folder of one", MISSING, positional=True, metavar="IN")
    out: Path = option(
        "file, or folder for colmap and ocam", MISSING, positional=True, metavar="OUT"
    )
    unit: Literal["mm", "cm", "m"] | None = option(
        "unit of the poses, if the file does not state it"
    )
    keep_frame: bool = option("do not turn the rig level", False)
    size: str | None = option(
        "of images that were resized as a whole", unset="of the file", metavar="WIDTHxHEIGHT"
    )
    to: Literal["omnimvs", "ocam", "kalibr", "opencv", "colmap", "nerfstudio"] = option(
        "program whose files are written", "omnimvs"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size is not None and not re.fullmatch("[0-9]{1,6}x[0-9]{1,6}", self.size):
            raise OmnistereoError(f"--size is {self.size}; expected WIDTHxHEIGHT, such as 800x768")
        if self.source.resolve() == self.out.resolve():
            raise OmnistereoError(f"{self.out} is the file that is read. Give another name")


def run(options: RigFileOptions) -> None:
    """Read a rig, say what was assumed, write it, and print the next command."""
    from omnistereo_rigs.formats.read import read_rig
    from omnistereo_rigs.formats.write import convert, resized

    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        read = read_rig(options.source, options.unit, options.max_fov, options.keep_frame)
    rig, said = read.rig, _assumed(options, read)
    found = [str(doubt.message).removeprefix(f"{options.source}: ") for doubt in doubts]
    if options.size is not None:
        width, height = map(int, options.size.split("x"))
        rig = resized(rig, (width, height))
        said.append(
            f"resized: to {width} × {height} px (pixel centres at whole numbers, u → (u + ½) s - ½)"
        )
    said += [f"{options.to}: {sentence}" for sentence in convert(rig, options.to, options.out)]
    word = "Fair" if found else "Good"
    low, high = rig.baselines.min(), rig.baselines.max()
    print(f"{word}: {len(rig)} cameras, {low:.3g} to {high:.3g} m apart.")
    print(*said, sep="\n")
    print("doubts: ", "\n         ".join(found) or "none")
    # What our commands cannot read back, as it states no unit, is a file to open.
    states_unit = options.to in ("omnimvs", "kalibr")
    doctor = shlex.join(["omnistereo", "doctor", "--rig", str(options.out)])
    print(doctor if states_unit else options.out)


def _assumed(options: RigFileOptions, read: RigReading) -> list[str]:
    """Return what was assumed: format and unit, lenses, field of view, turn."""
    from omnistereo_tools.judge.coverage import turn_sentence

    rig = read.rig
    found = read.found
    unit = f"{found.unit} by the format" if found.unit else f"{options.unit} (--unit)"
    models = ", ".join(dict.fromkeys(lens.model for lens in found.lenses)) or "ocam"
    sizes = ", ".join(
        dict.fromkeys(f"{w} × {h} px" for w, h in (camera.image_size for camera in rig.cameras))
    )
    fields = sorted({round(camera.max_fov_deg, 1) for camera in rig.cameras})
    field = f"{fields[0]:g}°" if len(fields) == 1 else f"{fields[0]:g}° to {fields[-1]:g}°"
    if limited := read.limited():
        numbers = ", ".join(map(str, limited))
        field += f"; camera {numbers}: no more can have been measured, --max-fov goes on"
    return [
        f"{options.source}: {found.name}; {unit}",
        f"lenses:  {models}, {sizes}, followed to {max(read.residuals_px, default=0):.2f} px at "
        "worst",
        f"field:   {field}",
        f"frame:   {turn_sentence(rig) or 'that of the file'}",
    ]
