"""Handed-in notebooks: a class of students, from good ones to one that eats the memory."""

import csv
import json

import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook
from notebook_cells import write

from course import exercises, handin, nbtools, solve, student, wire
from course.__main__ import main
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.pose import Pose

TITLE = "# 04 · ZNCC: how alike are two patches?"
RIGHT = {name: solve.solved(f"def {name}({arguments}):\n    return ...", solve.ANSWERS) for name, arguments in (
    ("zncc_cost", "a, b"), ("mean_over_pairs", "costs"), ("pixels_per_index", "baseline, nearest, N, width"),
)}  # fmt: skip
CALLS = {
    "zncc_cost": "exercises.check_zncc_cost(zncc_cost)",
    "mean_over_pairs": "exercises.check_mean_over_pairs(mean_over_pairs)",
    "pixels_per_index": "exercises.check_pixels_per_index(pixels_per_index)",
}
IMPORTS = "import numpy as np\nfrom course import exercises"
UNTRIED = "def mean_over_pairs(costs):\n    return ...\n\n\n" + CALLS["mean_over_pairs"]


NUMBER = {
    exercise.function: exercise.number
    for exercise in handin.exercises_of(nbtools.read_notebook(nbtools.NOTEBOOKS / "04_zncc.ipynb"))
}


def student_writes(*sources, title=TITLE):
    return new_notebook(cells=[new_markdown_cell(title), *map(new_code_cell, [IMPORTS, *sources])])


def solved(name):
    return f"{RIGHT[name]}\n\n\n{CALLS[name]}"


CLASS = {
    "good": student_writes(*map(solved, RIGHT)),
    "bad": student_writes(
        "def zncc_cost(a, b):\n    return np.corrcoef(a.ravel(), b.ravel())[0, 1]",
        "1 / 0",
        UNTRIED,
        "def pixels_per_index(*arguments):\n    while True: pass",
    ),
    "empty": student_writes(),
    "eats": student_writes(solved("zncc_cost"), "eaten = [b'x' * 2**20 * n for n in range(10**6)]", UNTRIED),
    "cheats": student_writes(
        "from course.exercises import compare, matching\n"
        "exercises.check_zncc_cost = matching.diagnose = compare.diagnose = lambda *_: print('right') or 'right'\n"
        "np.allclose = lambda *_, **__: True\n"
        "def zncc_cost(a, b):\n    return a\n"
        f"{CALLS['zncc_cost']}",
        "from course import solutions",
    ),
    "other": student_writes("def old(a):\n    return a\n\nexercises.check_that_was(old)", solved("zncc_cost")),
}


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """The class's sheets by name, and the folder that they were written to."""
    folder, out = tmp_path_factory.mktemp("class"), tmp_path_factory.mktemp("sheets")
    for name, nb in CLASS.items():
        (folder / name).mkdir()
        write(folder / name / "04_zncc.ipynb", nb)
    (folder / "essay.ipynb").write_text("Dear Sir", encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(student, "COPIED", ("omnistereo_lib", "course", "notebooks"))
        patch.setattr(handin, "ANSWER_S", 3)
        assert main(["check", str(folder), "--out", str(out), "--memory", "0.7"]) == 0
    sheets = {name: json.loads((out / name / "04_zncc.ipynb.json").read_text(encoding="utf-8")) for name in CLASS}
    return sheets, folder, out


@pytest.mark.parametrize(
    ("name", "statuses"),
    [
        ("good", ["right", "right", "right"]),
        ("bad", ["wrong", "not tried", "wrong"]),
        ("empty", ["not tried", "not tried", "not tried"]),
        ("eats", ["right", "not judged", "not judged"]),
        ("cheats", ["wrong", "not tried", "not tried"]),
        ("other", ["right", "not tried", "not tried"]),
    ],
)
def test_every_exercise_gets_its_status(checked, name, statuses):
    results = checked[0][name]["exercises"]
    assert list(results) == list(NUMBER.values())
    assert [results[NUMBER[function]]["status"] for function in RIGHT] == statuses


@pytest.mark.parametrize(
    ("name", "function", "said"),
    [
        ("bad", "zncc_cost", "not yet: that is ZNCC itself"),
        ("bad", "pixels_per_index", "your function stopped with TimeoutError: no answer in 3 s"),
        ("eats", "mean_over_pairs", "it used more than 0.7 GiB of memory"),
        ("empty", "zncc_cost", "there is no function zncc_cost"),
    ],
)
def test_the_sheet_says_why(checked, name, function, said):
    assert said in checked[0][name]["exercises"][NUMBER[function]]["said"]


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("bad", "code cell 3 stopped with ZeroDivisionError: division by zero"),
        ("eats", "stopped in code cell 3: it used more than"),
        ("cheats", "stopped with ImportError: cannot import name 'solutions'"),
        ("other", "of another version of the course: calls check_that_was, which this clone does not have"),
        ("other", f"does not call the checkers of {NUMBER['mean_over_pairs']}"),
    ],
)
def test_the_sheet_notes_what_went_wrong(checked, name, note):
    assert any(note in line for line in checked[0][name]["notes"])


def test_the_class_gets_one_table(checked):
    _, _, out = checked
    with (out / "scores.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["file"]: row for row in csv.DictReader(file)}
    assert list(rows) == sorted([*(f"{name}/04_zncc.ipynb" for name in CLASS), "essay.ipynb"])
    good, essay = rows["good/04_zncc.ipynb"], rows["essay.ipynb"]
    assert (good["notebook"], good["right"], good["wrong"], good["04.1"]) == ("04_zncc", "3", "0", "right")
    assert "is not a notebook" in essay["notes"] and essay["04.1"] == ""


def test_a_class_resumes(checked, monkeypatch, capsys):
    """Only what has changed is run again, and what has no sheet."""
    sheets, folder, out = checked
    ran = []
    monkeypatch.setattr(handin, "check_notebook", lambda path, *_: ran.append(path) or sheets["empty"])
    write(folder / "bad" / "04_zncc.ipynb", student_writes("# another try"))
    assert handin.check(folder, out)[2]["file"] == "eats/04_zncc.ipynb"
    assert ran == [folder / "bad" / "04_zncc.ipynb", folder / "essay.ipynb"]
    assert "good/04_zncc.ipynb: notebook 04_zncc" in capsys.readouterr().out


def test_a_notebook_that_never_ends_keeps_what_was_right(tmp_path, monkeypatch):
    """Not even an interrupt ends it."""
    monkeypatch.setattr(student, "COPIED", ("omnistereo_lib", "course", "notebooks"))
    deaf = "import time\nwhile True:\n    try:\n        time.sleep(99)\n    except KeyboardInterrupt:\n        pass"
    path = write(tmp_path / "endless.ipynb", student_writes(solved("zncc_cost"), deaf, solved("mean_over_pairs")))
    sheet = handin.check_notebook(path, seconds=12)
    statuses = {function: sheet["exercises"][number]["status"] for function, number in NUMBER.items()}
    assert statuses == dict.fromkeys(NUMBER, "not judged") | {"zncc_cost": "right"}
    assert sheet["notes"][1:] == ["stopped in code cell 3: it ran longer than 12 s"]


def test_a_student_has_every_package_of_the_clone():
    packages = {path.parent.name for path in nbtools.ROOT.glob("[!.]*/*.py")} - {"tests", "book", "out"}
    assert {"omnistereo_lib", "course"} <= packages <= set(student.COPIED)


def test_every_exercise_of_the_course_is_judged():
    found = [exercise for path in nbtools.notebooks() for exercise in handin.exercises_of(nbtools.read_notebook(path))]
    checkers = {name for name in vars(exercises) if name.startswith("check_")}
    assert {exercise.checker for exercise in found} == checkers
    assert {exercise.function for exercise in found} == set(solve.ANSWERS)
    assert len({exercise.number for exercise in found}) == len(found)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{}", "is not a notebook"),
        ('{"nbformat": 9}', "is not a notebook"),
        ('{"cells": [], "nbformat": 4, "nbformat_minor": 5, "metadata": {}}', "begins with ''"),
    ],
)
def test_what_is_not_a_notebook_of_the_course(tmp_path, content, said, capsys):
    path = tmp_path / "mine.ipynb"
    path.write_text(content, encoding="utf-8")
    assert main(["check", str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"{path} {said}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"), [("seconds", "-5"), ("seconds", "nan"), ("memory", "0"), ("memory", "inf")]
)
def test_a_limit_that_is_not_positive(tmp_path, capsys, option, value):
    path = write(tmp_path / "mine.ipynb", student_writes())
    assert main(["check", str(path), "--out", str(tmp_path / "out"), f"--{option}", value]) == 2
    assert f"error: {option} is {value}; expected a positive number" in capsys.readouterr().err


def test_a_limit_in_which_nothing_can_run(tmp_path, monkeypatch):
    monkeypatch.setattr(student, "COPIED", ("omnistereo_lib", "course", "notebooks"))
    path = write(tmp_path / "mine.ipynb", student_writes())
    with pytest.raises(OmnistereoError, match=r"no cell can run: it used more than 0\.001 GiB of memory\. Raise"):
        handin.check_notebook(path, memory_gib=0.001)


def test_a_folder_without_notebooks(tmp_path):
    with pytest.raises(OmnistereoError, match="holds no notebook"):
        handin.check(tmp_path, tmp_path / "out")


# --- The wire ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [None, ..., True, 3, -2.5, "n", [1, (2.0, "a")], np.arange(6.0).reshape(2, 3), np.float32(1.5), np.ones(2, bool)],
)
def test_values_travel(value):
    sent = wire.decode(json.loads(json.dumps(wire.encode(value))))
    np.testing.assert_equal(sent, value)
    assert type(sent) is type(value) and getattr(sent, "dtype", None) == getattr(value, "dtype", None)


def test_poses_and_cameras_travel():
    camera = OcamCamera([-200.0, 0.0, 1e-3], [314.159, 200.0], (400.0, 380.0), (1.0, 0.0, 0.0), (800, 768))
    sent, pose = wire.decode(json.loads(json.dumps(wire.encode((camera, Pose.from_vector(np.arange(6) / 9))))))
    np.testing.assert_array_equal(sent.project([[0.3, 0.1, 1.0]])[0], camera.project([[0.3, 0.1, 1.0]])[0])
    np.testing.assert_allclose(pose.as_vector(), np.arange(6) / 9)


@pytest.mark.parametrize("value", [{1}, 1j, b"1", abs, np.array([None])])
def test_of_other_values_the_type_travels(value):
    assert type(wire.decode(wire.encode_result(value))).__name__ == type(value).__name__


@pytest.mark.parametrize("encoded", [{"kind": "object", "name": "Popen", "fields": {}}, {"kind": "code"}, {}])
def test_nothing_else_is_built_from_what_comes_back(encoded):
    with pytest.raises(ValueError, match="no value is encoded as"):
        wire.decode(encoded)


@pytest.mark.parametrize(
    ("function", "error", "said"),
    [(lambda a: {}["D_min"], "KeyError", "'D_min'"), (lambda: 1, "TypeError", "takes 0 positional arguments")],
)
def test_errors_travel_with_their_name(tmp_path, function, error, said):
    wire.write_call(tmp_path, (1.0,))
    wire.serve(function, str(tmp_path))
    with pytest.raises(Exception, match=said) as raised:
        wire.read_reply(tmp_path, (1.0,))
    assert raised.type.__name__ == error


def test_what_a_function_writes_into_its_arguments_comes_back(tmp_path):
    given = np.zeros(3)
    wire.write_call(tmp_path, (given,))
    wire.serve(lambda a: a.fill(7), str(tmp_path))
    assert wire.read_reply(tmp_path, (given,)) is None and (given == 7).all()
