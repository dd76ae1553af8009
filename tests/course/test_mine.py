"""The student's functions live on: kept, used by later notebooks, joined into one file."""

import ast
import sys

import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell
from scene import refused

import omnistereo_lib as osl
from course import exercises
from course.exercises import mine, nb03, nb04
from course.exercises.mine import Source
from course.nbtools import ROOT
from omnistereo_tools.own_method import run_own

FIRST = """import cv2
import numpy as np
from scipy.spatial.transform import Rotation
import omnistereo_lib as osl
from course.exercises import nb01, nb03, nb04, nb05"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a cell as Jupyter does, in a notebook of its own in my_notebooks."""
    (tmp_path / "my_notebooks").mkdir()
    monkeypatch.chdir(tmp_path / "my_notebooks")
    shell = InteractiveShell(user_ns={"__name__": "__main__"})

    def cell(source):
        result = shell.run_cell(source, silent=True)
        result.raise_error()
        return shell.user_ns

    cell(FIRST)
    return cell


def checked(run, function, source=None):
    """Write a function into the notebook and check it; the solution unless given."""
    run(source or function.source)
    return run(
        f"{function.name} ="
        f" nb{mine.number_of(function.answer)}.check_{function.name}({function.name})"
    )


def test_a_later_notebook_runs_what_was_kept_and_the_solution_elsewhere(run, capsys):
    checked(run, nb04.check_window_sums, "def window_sums(image, radius):\n    ...")
    run("half = 0.5\ndef both_see(a, b):\n    return np.isfinite(a) & np.isfinite(b)")
    source = nb04.check_zncc_costs.source.replace(
        "np.isfinite(a) & np.isfinite(b)", "both_see(a, b)"
    )
    checked(run, nb04.check_zncc_costs, source.replace("(1 - zncc) / 2", "(1 - zncc) * half"))
    said = capsys.readouterr().out
    until = "Until it is right, the cells below run with the solution."
    assert f"window_sums: yours to write. {until}" in said
    assert "in this notebook, kept in mine/nb04.py. The notebook goes on with yours." in said
    kept = Source.of((mine.folder() / "nb04.py").read_text())
    assert list(kept.pieces) == ["both_see", "half", "zncc_costs"]
    assert kept.imports["window_sums"] == "from course.exercises.nb04 import window_sums"
    own, other = mine.use("04.zncc_costs", "04.winner")
    assert capsys.readouterr().out == "yours: 04.zncc_costs; solution: 04.winner\n"
    assert other is nb04.winner and own is not nb04.zncc_costs
    inputs = nb04.check_zncc_costs.inputs(3)
    np.testing.assert_array_equal(own(*inputs), nb04.zncc_costs(*inputs))
    # Once its own window_sums is right, that is what it calls.
    checked(run, nb04.check_window_sums)
    kept = Source.of((mine.folder() / "nb04.py").read_text())
    assert "window_sums" in kept.pieces and "window_sums" not in kept.imports


def test_nothing_is_kept_elsewhere(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    nb03.check_look_up(lambda *inputs: nb03.look_up(*inputs))
    assert "right" in capsys.readouterr().out and not list(tmp_path.iterdir())
    assert mine.use("03.look_up") == [nb03.look_up]


def test_what_hangs_on_the_notebook_is_not_kept_and_says_why(run, capsys):
    run("table = np.zeros((99, 99))")
    changed = nb03.check_look_up.source.replace("a, b = u", "table.sum(); a, b = u")
    checked(run, nb03.check_look_up, changed)
    assert (
        "not kept for later notebooks: it uses `table`, a ndarray of the notebook"
        in capsys.readouterr().out
    )
    assert not (mine.folder() / "nb03.py").exists()


def test_a_broken_file_is_said_and_the_solution_runs(run, capsys):
    checked(run, nb03.check_look_up)
    (mine.folder() / "nb03.py").write_text("def look_up(:")
    capsys.readouterr()
    assert mine.use("03.look_up") == [nb03.look_up]
    assert capsys.readouterr().out.startswith("mine/nb03.py stops with SyntaxError")


def test_a_right_but_slow_answer_is_told_so(run, capsys, monkeypatch):
    """By a clock that goes faster while the student's function runs: no machine's load matters."""
    clock = {"now": 0.0}
    monkeypatch.setattr("course.exercises.opened.time.process_time", lambda: clock["now"])

    def taking(seconds, function):
        def timed(*inputs):
            clock["now"] += seconds
            return function(*inputs)

        return timed

    monkeypatch.setattr(nb03.check_look_up, "answer", nb03.look_up)
    monkeypatch.setitem(run("")["nb03"].__dict__, "tick", clock)
    source = nb03.check_look_up.source.replace("    u, v", "    clock['now'] += 2.0\n    u, v", 1)
    run("")["clock"] = clock
    solution = taking(0.01, nb03.look_up)
    solution.__name__, solution.__module__ = "look_up", nb03.__name__
    monkeypatch.setattr(nb03.check_look_up, "answer", solution)
    checked(run, nb03.check_look_up, source)
    said = capsys.readouterr().out
    assert "look_up: right, and 200 times slower than the solution" in said
    assert said.endswith("The notebook goes on with the solution.\n")
    assert run("")["look_up"] is solution


def test_all_functions_make_a_method_that_needs_no_library_and_finds_what_the_library_finds(
    run, capsys
):
    """By float32 and where costs tie, errors differ by 0.2 points at most: 12 of 6400 rays."""
    for function in [f for number in ("01", "03", "04", "05") for f in exercises.functions(number)]:
        checked(run, function)
    assert (
        "mine/omnistereo.py: depth from images by 11 functions of yours." in capsys.readouterr().out
    )
    file = mine.folder() / "omnistereo.py"
    roots = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).partition(".")[0]
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert roots == {"cv2", "numpy"}
    for name in ("sunny", "indoor"):
        data = osl.load_dataset(ROOT / "data_samples" / name, split="test")
        frame = data.frame(831) if name == "sunny" else data[0]
        grid = osl.SphereGrid(160, 40, num_spheres=32, min_depth=data.rig.min_depth)
        own = run_own(file, osl.SphereSweep(frame.rig, grid), frame.images).depth
        library = osl.estimate_depth(frame, grid, "zncc+sgm")
        truth = frame.gt_index(grid)
        errors = [osl.index_error(depth.index, truth, 32) for depth in (own, library)]
        assert all(
            abs(errors[0][key] - errors[1][key]) < 0.3 for key in (">1", ">3", ">5", "MAE", "RMS")
        ), errors
        apart = np.abs(own.index - library.index)
        assert np.mean(apart > 0.05) < 0.03 and np.mean(apart > 0.5) < 0.005


def test_names_that_two_notebooks_use_otherwise_get_apart():
    whole = Source.of("import numpy as np\n\n\ndef pad(x):\n    return np.pad(x, 1)\n")
    part = Source.of("from math import hypot as np\n\n\ndef pad(x):\n    return np(x, pad.size)\n")
    mine._join(whole, part, "04", set())
    namespace = {}
    exec(whole.text(""), namespace)
    assert namespace["pad"](np.zeros(1)).shape == (3,)
    assert "return np_04(x, pad_04.size)" in whole.pieces["pad_04"]
    assert sys.modules["math"].hypot is namespace["np_04"]


METHODS = {
    "def depth(images, cameras, grid):\n    return [1, 2]": (
        r"returns index of shape \(2,\); expected \(8, 32\)"
    ),
    "def depth(images, cameras, grid):\n    import os; os.abort()": (
        "without an answer, killed by SIGABRT"
    ),
    "def depth(images, cameras, grid):\n    return grid.nothing": (
        "AttributeError.*, in line 2: return grid.nothing"
    ),
    "def depth(images, cameras, grid):\n    return 'text'": "returns index of str",
    "import numpy as np\ndef depth(i, c, g):\n    return np.ones((8, 32), bool)": (
        "returns index of dtype bool; expected sphere indices"
    ),
    "import numpy as np\ndef depth(i, c, g):\n    return np.full((8, 32), 99)": (
        "99; expected 0 to 15, and NaN"
    ),
    "import numpy as np\ndef depth(i, c, g):\n    return np.full((8, 32), np.nan)": (
        "all its indices are NaN"
    ),
    "depth = 3": "has no function `depth`",
}


@pytest.mark.parametrize("source", METHODS)
def test_what_is_wrong_with_a_method_of_ones_own_is_said(source, tmp_path):
    (tmp_path / "own.py").write_text(source)
    frame = osl.load_dataset(ROOT / "data_samples" / "sunny", split="test")[0]
    sweep = osl.SphereSweep(frame.rig, osl.SphereGrid(32, 8, num_spheres=16, min_depth=1.65))
    with refused(METHODS[source]):
        run_own(tmp_path / "own.py", sweep, frame.images)
