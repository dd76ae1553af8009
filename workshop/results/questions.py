"""Ten questions a reader of the code asks, and what must be read for each: traced, not counted by
hand.

Each question has a call that answers it. The call runs under a tracer, which notes every function
of this project that is entered. The *trunk* are those that lead to the functions named as its
goals, and the goals; all others are branches: checks, conversions, reading of files. Compiled
kernels are not entered as Python functions and do not count.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch

import omnistereo_lib as osl
from omnistereo_lib.files import write_text
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.stereo import threads
from omnistereo_lib.stereo.methods import FRAME_METHOD

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "CONTRIBUTING.md"
_FOLDERS = tuple(f"{ROOT / name}/" for name in ("omnistereo_lib", "omnistereo_tools", "course"))
_GRID = osl.SphereGrid(96, 24, num_spheres=16, min_depth=1.65)
_TABLE = re.compile(r"(?<=\| ---: \|\n)(?:\|.*\n)+")

Place = tuple[str, str]  # file and name: a function, Class.method, class or table


@dataclass(frozen=True)
class Question:
    """A question, the call that answers it, and where it leads."""

    text: str
    prepare: Callable[[], Callable[[], object]]  # returns the call; what it needs is made before
    goals: tuple[str, ...]  # names of functions, as `Class.method`
    stop: bool = False  # the call ends where the first goal is reached
    also: tuple[Place, ...] = ()  # what is read beside functions: classes and tables


class _ReachedError(BaseException):
    """Ends a call at its goal. Not an Exception: the command line would report it."""


def trace(question: Question) -> tuple[list[Place], list[Place]]:
    """Return trunk and branches of a question, each function once, in the order in which they are
    entered.
    """
    call = question.prepare()
    # Twice: modules are imported and kernels compiled when they are first used.
    _run(call, question, {})
    entered: dict[Place, bool] = dict.fromkeys(question.also, True)
    _run(call, question, entered)
    trunk, branches = (
        [place for place in entered if entered[place] is leads] for leads in (True, False)
    )
    return trunk, branches


def _run(call: Callable[[], object], question: Question, entered: dict[Place, bool]) -> None:
    """Run a call, hide what it prints, and note what is entered, in its threads too: True where it
    leads to a goal.
    """

    def note(frame: FrameType, event: str, argument: object) -> None:
        if event != "call" or (place := _place(frame)) is None:
            return
        entered.setdefault(place, False)
        if place[1] not in question.goals:
            return
        # At a goal, all that is on the call stack has led here.
        above: FrameType | None = frame
        while above is not None and above.f_code.co_filename != __file__:
            if (one := _place(above)) is not None:
                entered[one] = True
            above = above.f_back
        if question.stop:
            raise _ReachedError

    hidden = io.StringIO()
    # threads that are kept would not be traced, and later ones for ever
    threads._pool.cache_clear()
    with (
        contextlib.redirect_stdout(hidden),
        contextlib.redirect_stderr(hidden),
        contextlib.suppress(_ReachedError),
    ):
        threading.setprofile(note)
        sys.setprofile(note)
        try:
            call()
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
            threads._pool.cache_clear()


def _place(frame: FrameType) -> Place | None:
    """Return file and name of a function of this project, of a nested one those of the function
    around it.
    """
    code = frame.f_code
    ours = code.co_filename.startswith(_FOLDERS) and code.co_filename != __file__
    if not ours or not code.co_flags & CO_OPTIMIZED:  # bodies of modules and classes run on import
        return None
    name = code.co_qualname.split(".<locals>")[0]
    return None if "<" in name else (str(Path(code.co_filename).relative_to(ROOT)), name)


def lines_of(place: Place) -> int:
    """Return the lines of a function, class, method or table, with its docstring."""
    file, name = place
    body = _parsed(file).body
    *classes, last = name.split(".")
    for part in classes:
        body = next(
            node.body for node in body if isinstance(node, ast.ClassDef) and node.name == part
        )
    for node in body:
        names = [
            getattr(node, "name", ""),
            *(getattr(target, "id", "") for target in getattr(node, "targets", [])),
        ]
        if last in names and node.end_lineno is not None:
            first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
            return node.end_lineno - first + 1
    raise LookupError(f"{file} has no {name}")


@cache
def _parsed(file: str) -> ast.Module:
    return ast.parse((ROOT / file).read_text(encoding="utf-8"))


def size_of(places: list[Place]) -> tuple[int, int]:
    """Return lines and files of some places."""
    return sum(map(lines_of, places)), len({file for file, _ in places})


def row(question: Question) -> str:
    """Return the row of the page: the question, its trunk, the size of the trunk and of all that is
    entered.
    """
    trunk, branches = trace(question)
    by_file: dict[str, list[str]] = {}
    for file, name in trunk:
        by_file.setdefault(file, []).append(f"`{name}`")
    places = ", ".join(f"`{file}` {' '.join(names)}" for file, names in by_file.items())
    cells = [
        question.text,
        places,
        *("{} in {}".format(*size_of(some)) for some in (trunk, trunk + branches)),
    ]
    return f"| {' | '.join(cells)} |\n"


def write_page() -> None:
    """Trace all questions again and write the table of CONTRIBUTING.md."""
    rows = "".join(map(row, QUESTIONS))
    print(rows)
    page = PAGE.read_text(encoding="utf-8")
    write_text(PAGE, _TABLE.sub(lambda _: rows, page, count=1))


# ---- The calls ----


def _depth(method: str) -> Callable[[], object]:
    frame = osl.load_dataset(ROOT / "data_samples/sunny", split="test")[0]
    _ = frame.images  # read before the call
    return lambda: osl.estimate_depth(frame, _GRID, method)


def _definition() -> Callable[[], object]:
    from omnistereo_lib import reference

    rig, grid = (
        osl.load_rig(ROOT / "data_samples/sunny/test"),
        osl.SphereGrid(32, 8, num_spheres=4, min_depth=1.65),
    )
    images = [torch.rand(camera.image_size[::-1]) for camera in rig.cameras]
    return lambda: reference.estimate(images, rig, grid, [(0, 1)], window=3, p1=0.1, p2=1.0)


def _added_cost() -> Callable[[], object]:
    from omnistereo_lib.stereo.cost import BlockCost
    from omnistereo_lib.stereo.methods import COSTS, CostEntry

    class Difference(BlockCost):
        def __call__(
            self, spherical_images: Any, pairs: Sequence[Pair], columns: Any = None
        ) -> torch.Tensor:
            costs = [
                (spherical_images[i] - spherical_images[j]).abs().clamp(max=1) for i, j in pairs
            ]
            return torch.stack(costs).nanmean(0).permute(1, 2, 0)

    estimate = _depth("zncc")

    def call() -> None:
        before, COSTS["zncc"] = (
            COSTS["zncc"],
            CostEntry("Difference", lambda method, path, precision: Difference()),
        )
        try:
            estimate()
        finally:
            COSTS["zncc"] = before

    return call


def _kalibr_rig() -> Callable[[], object]:
    lens = {
        "camera_model": "ds",
        "intrinsics": [-0.28, 0.57, 230, 230, 400, 384],
        "distortion_model": "none",
    }
    lens |= {"distortion_coeffs": [], "resolution": [800, 768]}
    T = np.eye(4)
    T[0, 3] = -0.1

    def call() -> object:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "camchain.yaml"
            path.write_text(json.dumps({"cam0": lens, "cam1": lens | {"T_cn_cnm1": T.tolist()}}))
            return osl.load_rig(path)

    return call


def _table_1() -> Callable[[], object]:
    return lambda: osl.SweepNet()(torch.zeros(1, 16, 96), torch.zeros(1, 16, 96))


def _sample() -> Callable[[], object]:
    from omnistereo_learn import RECIPES
    from omnistereo_learn.samples.volumes import VolumeSamples

    recipe: Any = RECIPES["volumenet"]["teaching"]
    samples = VolumeSamples(recipe, [ROOT / "data_samples/sunny/train"])
    rng = np.random.default_rng(0)
    return lambda: samples.micro_batch(samples.training_frame(0), rng, augment=True)


def _bundle() -> Callable[[], object]:
    from omnistereo_rigs.boards.bundle import bundle_adjust
    from omnistereo_rigs.boards.init import initial_estimate
    from omnistereo_rigs.boards.params import collect_observations

    board, true = (
        osl.Checkerboard((8, 6), square=0.05),
        osl.load_rig(ROOT / "data_samples/sunny/test").cameras[0],
    )
    poses = [
        osl.Pose.from_vector([np.sin(k) / 2, np.cos(k) / 2, 0, k / 10 - 0.4, -0.1, 0.3])
        for k in range(8)
    ]
    views = [true.project(pose @ board.points)[0] for pose in poses]
    params = initial_estimate(views, board.points, true.image_size)
    return lambda: bundle_adjust(params, collect_observations([views], board.points))


def _command() -> Callable[[], object]:
    from omnistereo_tools.cli import main

    def call() -> int:
        with tempfile.TemporaryDirectory() as folder:
            return main(
                ["depth", "--width", "320", "--height", "80", "--spheres", "64", "--out", folder]
            )

    return call


def _checker() -> Callable[[], object]:
    from course.exercises import nb03

    return lambda: nb03.check_points_on_sphere(lambda rays, n, N, min_depth: rays)


_METHODS = "omnistereo_lib/stereo/methods.py"
QUESTIONS = (
    Question(
        "What does `estimate_depth` do?",
        lambda: _depth(FRAME_METHOD),
        ("FeatureNet.forward", "correlate", "VolumeNet.forward", "resize_logits", "local_mean"),
    ),
    Question("Where is Eq. 1?", _definition, ("warp", "project", "sample")),
    Question("How does SGM go around the seam?", _definition, ("message",)),
    Question(
        "How do I add a cost?",
        _added_cost,
        ("Method.cost_of",),
        also=((_METHODS, "CostEntry"), (_METHODS, "COSTS")),
    ),
    Question(
        "How do I add a rig format?",
        _kalibr_rig,
        ("fit_camera", "parse_matrix"),
        also=(
            ("omnistereo_rigs/formats/read.py", "FORMATS"),
            ("omnistereo_lib/parse.py", "Section"),
        ),
    ),
    Question("What is Table I?", _table_1, ("SweepNet.__init__", "SweepNet._run")),
    Question(
        "How is a training sample drawn?",
        _sample,
        (
            "TrainingFrames.training_frame",
            "VolumeSamples.view",
            "_other_look",
            "feature_coordinates",
            "Frame.inverse_depth_along",
        ),
    ),
    Question(
        "What does the bundle adjustment minimise?",
        _bundle,
        ("_UnpackedParams.__init__", "BundleProblem.residuals", "BundleProblem._polynomial"),
    ),
    Question(
        "What happens in `omnistereo depth` until the network has its first image?",
        _command,
        ("FeatureNet.forward",),
        stop=True,
    ),
    Question(
        "Where is the checker of 03.2, `points_on_sphere`, and its right answer?",
        _checker,
        ("points_on_sphere",),
        also=(("course/exercises/nb03.py", "check_points_on_sphere"),),
    ),
)
