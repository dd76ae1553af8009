"""The stored results again: `make results`. That takes hours, and resumes."""

import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from course.nbtools import ROOT
from workshop.publish.reproduction import renew_report
from workshop.render.image_sets import renew_manifest
from workshop.results.snapshots import take_snapshots

STORED = ROOT / "data_samples" / "results"
OUT = ROOT / "out"
_SETS = "sunny cloudy sunset indoor"
# the paper's penalties
_PAPERS = " ".join(f"{cost}+sgm,p1=0.1,p2=12" for cost in ("zncc", "mccnn", "sweepnet"))
_VOLUMENET = "volumenet volumenet+sgm"
_WORLDS = "sweepnet,weights=sweepnet_worlds sweepnet+sgm,weights=sweepnet_worlds"
RIG = OUT / "van" / "config.yaml"

CALIBRATE = (
    "calibrate data_samples/calibration/van --board 12x10 --square 0.06 --max-fov 220 --out"
    f" {RIG.parent}"
)
EVALUATIONS = {  # name of the stored result → arguments of `omnistereo evaluate`
    "teaching": f"--sets {_SETS}",
    "ablations": (
        f"--sets sunny --ablations window weights pairs wrap subindex spheres --methods {_PAPERS}"
    ),
    "calibrated": f"--sets sunny --rig {RIG}",
    # On training frames that the networks have not learned from.
    "penalties": ("--sets data_samples/sunny/train --frames 3 153 303 453 --ablations penalties"),
    "paper": f"--sets {_SETS} aerial --scale paper",
    "teaching-volumenet": f"--sets {_SETS} aerial --methods {_VOLUMENET}",
    "paper-volumenet": f"--sets {_SETS} aerial --methods {_VOLUMENET} --scale paper",
    "teaching-sweepnet_worlds": f"--sets {_SETS} aerial --methods {_WORLDS}",
    "paper-sweepnet_worlds": f"--sets indoor --methods {_WORLDS} --scale paper",
    "teaching-worlds": (
        "--sets things rooms --methods zncc zncc+sgm sweepnet+sgm "
        f"sweepnet+sgm,weights=sweepnet_worlds {_VOLUMENET}"
    ),
}


def compute_results(options: Sequence[str] = ()) -> None:
    """Evaluate, and store what comes out; `options` are further ones of every evaluation.

    variants.csv, volume_variants.csv and volume_worlds.csv beside them hold trainings in which one
    choice was changed at a time; commit 34d45a7 has the code that made them.
    """
    _omnistereo(CALIBRATE)
    for name, arguments in EVALUATIONS.items():
        _omnistereo(f"evaluate {arguments} --out {OUT / name}", *options)
        shutil.copyfile(OUT / name / "results.json", STORED / f"{name}.json")
    renew_report()
    take_snapshots()
    renew_manifest(ROOT / "data_samples")


def _omnistereo(command: str, *options: str) -> None:
    """Run a command in a process of its own, which gives its memory back."""
    program = Path(sys.executable).with_name("omnistereo")
    subprocess.run([program, *shlex.split(command), *options], cwd=ROOT, check=True)
