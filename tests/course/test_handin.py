"""Handed-in notebooks: a class, from good ones to attacks on the judge, gets its sheets."""

import csv
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook
from notebook_cells import write
from scene import refused

from course import exercises, nbtools
from course.__main__ import main
from course.classroom import handin, solve, student
from omnistereo_lib.geometry.pose import Pose

TITLE = "# 04 · ZNCC: how alike are two patches?"
IMPORTS = (
    "import json, os, sys, time\nfrom pathlib import Path\nimport numpy as np\nfrom"
    " course.exercises import nb04"
)

# Judging a class of accidents takes a minute.
pytestmark = pytest.mark.slow
ASKED = {
    e.function: e
    for e in handin.exercises_of(nbtools.read_notebook(nbtools.NOTEBOOKS / "04_zncc.ipynb"))
}
SMALL = ("omnistereo_lib", "course", "notebooks")  # of the clone: enough for these notebooks


def student_writes(*sources, names=""):
    return new_notebook(
        cells=[new_markdown_cell(TITLE), *map(new_code_cell, [IMPORTS + names, *sources])]
    )


def solved(name):
    return solve.solved(f"def {name}():\n    ...\n\n\n{call(name)}", solve.open_answers("04"))


def call(name):
    return f"{name} = {ASKED[name].checker}({name})"


GOOD = solved("zncc")
STUB = f"def mean_of_pairs(costs):\n    ...\n\n\n{call('mean_of_pairs')}"
APART = """mine = Path.home() / '.ipython/profile_default/startup/mine.py'
assert not mine.exists() and not Path(os.environ['TMPDIR'], 'mine').exists()
mine.parent.mkdir(parents=True, exist_ok=True)
mine.write_text('zncc = 1')
Path(os.environ['TMPDIR'], 'mine').touch()
assert not {"IPYTHONDIR", "JUPYTER_CONFIG_DIR", "XDG_CONFIG_HOME"} & set(os.environ)
assert [path for path in sys.path if Path(path, 'course').is_dir()] == [str(Path('..').resolve())]
assert Path('../out').exists(), 'no solutions here'"""
DAEMON = """if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        while True:
            with open(LOG, 'a') as log:
                log.write('.')
            time.sleep(0.01)
    os._exit(0)
while not os.path.exists(LOG):
    time.sleep(0.01)"""
FORGED = """for fd in range(3, 30):
    for line in ('{"function": "zncc", "replies": "right"}', '{"function": [], "cell": {}}',
                 '[' * 100000,
                 '{"function": "mean_of_pairs", "replies": [{"error": "a\\\\u0000", "text": {}}]}',
                 '\\xff', '{"end": 1}'):
        try:
            os.write(fd, line.encode('latin-1') + b'\\n')
        except OSError:
            pass"""
PIPES = """for path in [*Path('..').resolve().parent.rglob('*')]:
    if path.is_file():
        path.unlink()
        os.mkfifo(path)"""
KNOWN = """checker = nb04.check_zncc
cases = [checker.inputs(k) for k in range(10)]
known = {case[0].tobytes(): checker.answer(*case) for case in cases}


def zncc(a, b):
    return known.get(a.tobytes(), 0)"""
MUTE = """class Mute(Exception):
    def __str__(self):
        raise SystemExit


raise Mute"""
CHEAT = """from course.exercises import compare, opened
opened.diagnose = compare.diagnose = lambda *_: 'right'
np.allclose = lambda *_, **__: True


def zncc(a, b):
    return a"""
DEAF = "while True:\n    try:\n        time.sleep(99)\n    except BaseException:\n        pass"
WRONG = "def zncc(a, b):\n    return (1 - nb04.zncc(a, b)) / 2"
SLOW = "def winner(*arguments):\n    time.sleep(99)"
EATEN = "eaten = [b'x' * 2**20 * n for n in range(10**6)]"
FORKS = "for _ in range(5):\n    os.fork()\ntime.sleep(99)"
BROKEN = "raise ValueError('\\ud83d\\x1b[2J')"
LEFT = """import atexit, threading
for _ in range(3000):
    os.mkdir('d')
    os.chdir('d')
atexit.register(time.sleep, 99)
threading.Thread(target=time.sleep, args=(99,), name='sleeper').start()
while True:
    print('x' * 10**6)"""
# What a student writes, the statuses of three functions ("tried" stands for "not tried"), and what
# a note says.
JUDGED = {
    "good": ((GOOD, solved("mean_of_pairs"), solved("winner")), "right right right", ""),
    "bad": (
        (WRONG, "1 / 0", STUB, SLOW),
        "wrong tried wrong",
        "3 stopped with ZeroDivisionError: division by zero",
    ),
    "in one cell": ((f"{WRONG}\n\n\n{call('zncc')}",), "wrong tried tried", ""),
    "empty": ((), "tried tried tried", "does not call the checkers of zncc, window_sums"),
    "cheats": ((CHEAT,), "wrong tried tried", ""),
    "borrows": (("zncc = nb04.zncc", call("zncc")), "tried tried tried", ""),
    "knows the cases": ((KNOWN, call("zncc")), "wrong tried tried", ""),
    "forges": ((FORGED,), "wrong wrong tried", ""),
}
# The same of a right function, then a cell, then a stub.
ACCIDENTS = {
    "\udcff@": (
        "exercises.check_that_was(zncc)",
        "tried",
        "calls check_that_was, which the notebook here does not",
    ),
    "writes over it": ("zncc = None", "tried", ""),
    "eats": (EATEN, "judged", "stopped in code cell 3: it used more than 0.7 GiB"),
    "never ends": (DEAF, "judged", "stopped in code cell 3: it ran longer than 15 s"),
    "forks": (FORKS, "judged", "stopped in code cell 3: it ran more than 20 processes"),
    "dies": (
        "os.kill(os.getpid(), 9)",
        "judged",
        "stopped in code cell 3: its process ended with status -9",
    ),
    "=1+1": (DAEMON, "tried", ""),
    "leaves things": (
        f"os.chdir(os.environ['TMPDIR'])\n{LEFT}",
        "tried",
        "left threads behind: sleeper",
    ),
    "pipes": (PIPES, "tried", ""),
    "broken text": (BROKEN, "tried", r"code cell 3 stopped with ValueError: \ud83d\x1b[2J"),
    "terms": ("+".join(["1"] * 20_000), "tried", "code cell 3 stopped with RecursionError"),
    "mute": (MUTE, "tried", "code cell 3 stopped with Mute"),
    "apart 1": (APART, "tried", "code cell 3 stopped with AssertionError: no solutions here"),
    "apart 2": (APART, "tried", "code cell 3 stopped with AssertionError: no solutions here"),
    "z spoils": (
        "Path(ENVIRONMENT, 'numpy.py').write_text('')",
        "tried",
        "the environment has changed",
    ),
}
JUDGED |= {
    name: ((GOOD, cell, STUB), f"right {rest} {rest}", note)
    for name, (cell, rest, note) in ACCIDENTS.items()
}
UNREADABLE = {
    "@essay": (lambda path: path.write_text("Dear Sir"), "is not a notebook"),
    "+nested": (lambda path: path.write_text("[" * 100_000), "is not a notebook"),
    "-pipe": (os.mkfifo, "is a folder, a pipe or a device"),
    "zeros": (lambda path: path.symlink_to("/dev/zero"), "is a folder, a pipe or a device"),
    "folder": (Path.mkdir, "is a folder, a pipe or a device"),
    "huge": (lambda path: path.touch() or os.truncate(path, 10**12), "expected a file of at most"),
}


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """The rows of the class's table by name, and the folders of the class and of the sheets."""
    folder, out, environment = map(tmp_path_factory.mktemp, ("class", "sheets", "environment"))
    (environment / "numpy.py").write_text("import fast\n")
    (out / "temporary").mkdir()
    names = f"\nLOG, ENVIRONMENT = {str(out / 'daemon.log')!r}, {str(environment)!r}"
    for name, (sources, *_) in JUDGED.items():
        nb = json.dumps(student_writes(*sources, names=names))
        (folder / f"{name}.ipynb").write_text(nb, encoding="utf-8")
    for name, (make, _) in UNREADABLE.items():
        make(folder / f"{name}.ipynb")
    with pytest.MonkeyPatch.context() as patch:
        for variable in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "XDG_CONFIG_HOME"):
            patch.setenv(variable, str(out))
        patch.setattr(tempfile, "tempdir", str(out / "temporary"))
        patch.setattr(student, "COPIED", SMALL)
        # Their own /tmp would hide the log and the environment of these tests.
        patch.setattr(student, "private", lambda folder: [])
        patch.setattr(student, "MAX_PROCESSES", 20)
        patch.setattr(handin, "ANSWER_S", 3)
        patch.setattr(handin, "ENVIRONMENT", [environment])
        limits = ["--memory", "0.7", "--seconds", "15"]
        assert main(["check", str(folder), "--out", str(out), *limits]) == 0
    with (out / "scores.csv").open(encoding="utf-8", newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}, folder, out


def test_a_class_ends_with_a_row_for_each(checked):
    assert len(checked[0]) == len(JUDGED) + len(UNREADABLE)


@pytest.mark.parametrize("name", JUDGED)
def test_every_exercise_gets_its_status_and_every_accident_a_note(checked, name):
    _, statuses, note = JUDGED[name]
    row = checked[0][shown(name)]
    assert [row[ASKED[f].number] for f in ("zncc", "mean_of_pairs", "winner")] == [
        {"tried": "not tried", "judged": "not judged"}.get(status, status)
        for status in statuses.split()
    ]
    assert note in row["notes"]


@pytest.mark.parametrize("name", UNREADABLE)
def test_what_cannot_be_read_gets_a_row_without_exercises(checked, name):
    row = checked[0][shown(name)]
    assert UNREADABLE[name][1] in row["notes"] and row["zncc"] == ""


def shown(name):
    """The name as the table has it: no formula, no broken letter."""
    return "'" * name.startswith(tuple("=+-@")) + name.replace("\udcff", r"\udcff") + ".ipynb"


@pytest.mark.parametrize(
    ("name", "function", "said"),
    [
        ("bad", "zncc", "not yet: that is the cost"),
        ("bad", "winner", "your function stopped with OutOfTime: no answer in 3 s"),
        ("eats", "mean_of_pairs", "it used more than 0.7 GiB of memory"),
        ("empty", "zncc", "there is no function zncc"),
    ],
)
def test_the_sheet_says_why(checked, name, function, said):
    sheet = json.loads((checked[2] / f"{name}.ipynb.json").read_text(encoding="utf-8"))
    assert said in sheet["exercises"][ASKED[function].number]["said"]


def test_nothing_that_a_student_has_started_is_left(checked):
    log = checked[2] / "daemon.log"
    size = log.stat().st_size
    time.sleep(0.2)
    assert log.stat().st_size == size > 0


def test_printing_without_end_stops_a_cell_and_nothing_is_left_of_a_folder_3000_deep(checked):
    rows, _, out = checked
    notes = rows["leaves things.ipynb"]["notes"]
    assert "code cell 3 stopped with OutOfTime: no answer in 5 s" in notes
    assert list((out / "temporary").iterdir()) == []


FILES = """import os
os.system("umount /tmp; umount /dev/shm")
for name in ("/tmp/left_by_student", "/dev/shm/left_by_student"):
    with open(name, "wb") as file:
        file.write(bytes(3_000_000))"""
MEMORY = """with open("/dev/shm/more_left_by_student", "wb") as file:
    for _ in range(8):
        file.write(bytes(100_000_000))"""


def test_files_in_tmp_and_shared_memory_are_private_counted_and_removed(tmp_path, monkeypatch):
    (tmp_path / "student").mkdir()
    if not student.private(tmp_path / "student"):
        pytest.skip("this system has no namespaces for its users")
    monkeypatch.setattr(student, "COPIED", SMALL)
    path = tmp_path / "a.ipynb"
    path.write_text(json.dumps(student_writes(FILES, GOOD, MEMORY)), encoding="utf-8")
    sheet = handin.check_notebook(path, seconds=120, memory_gib=0.7)
    assert "left 3 MiB of files behind, which were removed" in sheet["notes"]
    assert "stopped in code cell 4: it used more than 0.7 GiB of memory" in sheet["notes"]
    left = [path for folder in ("/tmp", "/dev/shm") for path in Path(folder).glob("*by_student")]
    assert left == []


def test_a_class_resumes(checked, monkeypatch, capsys):
    """What has changed is run again, what has no sheet, and what has a damaged one."""
    _, folder, out = checked
    ran = []
    sheet = json.loads((out / "empty.ipynb.json").read_text(encoding="utf-8"))
    monkeypatch.setattr(
        handin, "check_notebook", lambda path, *_: ran.append(path.stem) or dict(sheet)
    )
    monkeypatch.setattr(handin, "ENVIRONMENT", [])
    write(folder / "bad.ipynb", student_writes("# another try"))
    for name, damage in (("terms", "{"), ("dies", '{"exercises": 3}'), ("eats", "[" * 100_000)):
        (out / f"{name}.ipynb.json").write_text(damage, encoding="utf-8")
    (out / "mute.ipynb.json").unlink()
    os.mkfifo(out / "mute.ipynb.json")
    handin.check(folder, out)
    again = {"bad", "terms", "dies", "eats", "mute", "z spoils", "\udcff@"}
    assert set(ran) - set(UNREADABLE) == again
    assert "good.ipynb: notebook 04_zncc" in capsys.readouterr().out


def test_a_class_of_unreadable_ones_has_its_table(tmp_path):
    os.mkfifo(tmp_path / "pipe.ipynb")
    handin.check(tmp_path, tmp_path / "new" / "out")
    assert "pipe.ipynb" in (tmp_path / "new" / "out" / "scores.csv").read_text(encoding="utf-8")


def test_a_sheet_that_cannot_be_stored_stops_nobody(tmp_path, monkeypatch):
    """Its name is too long, or a folder is called like the table."""
    monkeypatch.setattr(handin, "ENVIRONMENT", [])
    monkeypatch.setattr(
        handin, "check_notebook", lambda *_: {"notebook": "04", "exercises": {}, "notes": []} | USED
    )
    (tmp_path / "scores.csv").mkdir()
    for name in ("scores.csv/c", "t", "u" * 245):
        (tmp_path / f"{name}.ipynb").touch()
    sheets = handin.check(tmp_path, tmp_path / "out")
    assert [bool(sheet["notes"]) for sheet in sheets] == [True, False, True]
    assert (tmp_path / "out" / "scores.csv").is_file()


def test_a_notebook_that_rewrites_another_is_named_on_both_sheets(tmp_path, monkeypatch):
    def check_notebook(path, *_):
        if path.stem == "a":
            (tmp_path / "b.ipynb").write_text("other")
        return {"notebook": "04", "exercises": {}, "notes": []} | USED

    monkeypatch.setattr(handin, "ENVIRONMENT", [])
    monkeypatch.setattr(handin, "check_notebook", check_notebook)
    for name in "abc":
        (tmp_path / f"{name}.ipynb").touch()
    notes = [sheet["notes"] for sheet in handin.check(tmp_path, tmp_path / "out")]
    assert "b.ipynb was rewritten while this one ran" in notes[0][0]
    assert "was rewritten while a.ipynb ran" in notes[1][0] and notes[2] == []


USED = {"seconds": 1.0, "peak_gib": 0.1}


def test_pipes_and_links_in_the_clone_are_not_copied(tmp_path, monkeypatch):
    monkeypatch.setattr(student, "ROOT", tmp_path)
    monkeypatch.setattr(student, "COPIED", ["notebooks"])
    for folder in ("notebooks/solutions", "notebooks/kept"):
        (tmp_path / folder).mkdir(parents=True)
    os.mkfifo(tmp_path / "notebooks" / "pipe")
    (tmp_path / "notebooks" / "zeros").symlink_to("/dev/zero")
    student.copy_clone(tmp_path / "copy")
    assert [path.name for path in (tmp_path / "copy" / "notebooks").iterdir()] == ["kept"]


def test_a_student_has_every_package_of_the_clone():
    packages = {path.parent.name for path in nbtools.ROOT.glob("[!.]*/*.py")}
    packages -= {"tests", "book", "out"}
    assert {"omnistereo_lib", "course"} <= packages <= set(student.COPIED)


def test_every_exercise_of_the_course_is_judged():
    found = [
        exercise
        for path in nbtools.notebooks()
        for exercise in handin.exercises_of(nbtools.read_notebook(path))
    ]
    numbers = [nbtools.number(path) for path in nbtools.notebooks()]
    opened = {
        function.name: f"nb{k}.check_{function.name}"
        for k in numbers
        for function in exercises.functions(k)
    }
    assert {exercise.checker for exercise in found} == set(opened.values())
    assert {exercise.function for exercise in found} == set(opened)
    assert len({exercise.number for exercise in found}) == len(found)


def test_a_notebook_of_nothing_in_the_course(tmp_path, capsys):
    path = tmp_path / "mine.ipynb"
    path.write_text(
        '{"cells": [], "nbformat": 4, "nbformat_minor": 5, "metadata": {}}', encoding="utf-8"
    )
    assert main(["check", str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"{path} begins with ''" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"), [("seconds", "-5"), ("seconds", "nan"), ("memory", "0"), ("memory", "inf")]
)
def test_a_limit_that_is_not_positive(tmp_path, capsys, option, value):
    path = write(tmp_path / "mine.ipynb", student_writes())
    assert main(["check", str(path), "--out", str(tmp_path / "out"), f"--{option}", value]) == 2
    assert f"error: {option} is {value}; expected a positive number" in capsys.readouterr().err


def test_a_limit_in_which_nothing_can_run(tmp_path, monkeypatch):
    monkeypatch.setattr(student, "COPIED", SMALL)
    path = write(tmp_path / "mine.ipynb", student_writes())
    with refused(r"no cell can run: it used more than 0\.001 GiB of memory\. Raise"):
        handin.check_notebook(path, memory_gib=0.001)


def test_a_folder_without_notebooks(tmp_path):
    with refused("holds no notebook"):
        handin.check(tmp_path, tmp_path / "out")


# --- What comes back from a function


def answered(function, *inputs):
    """What the judge gets of a function's answer, after the way there and back."""
    value = student.in_json(function(*inputs))
    reply = {"value": value, "arguments": [student.in_json(x) for x in inputs]}
    return handin.repeat(json.loads(json.dumps([reply])))(*inputs)


THIRDS = np.arange(6.0).reshape(2, 3) / 3
VALUES = [
    (None, None),
    (..., None),
    ([True, (2, "a")], [True, [2, "a"]]),
    (THIRDS, THIRDS.tolist()),
    (np.float32(1.5), 1.5),
    (np.array([np.nan, -np.inf, 1e-300]), [np.nan, -np.inf, 1e-300]),
    (Pose.from_vector(THIRDS.ravel()), Pose.from_vector(THIRDS.ravel()).as_vector().tolist()),
]


@pytest.mark.parametrize(("value", "expected"), VALUES)
def test_values_come_back(value, expected):
    np.testing.assert_equal(answered(lambda: value), expected)


def test_what_would_be_a_large_array_is_not_made_one():
    """An array of texts has the room of the longest for each: a megabyte would take 4 GiB."""
    with pytest.raises(MemoryError, match=r"would take 229\d MiB as an array"):
        answered(lambda: ["a" * 10**6] + [""] * 600)


@pytest.mark.parametrize("value", [{1}, 1j, b"1", abs, {(1, 2): 3}])
def test_of_other_values_the_type_comes_back(value):
    assert type(answered(lambda: value)).__name__ == type(value).__name__


@pytest.mark.parametrize(
    ("function", "said"),
    [(lambda a: {}["D_min"], "KeyError: 'D_min'"), (lambda: 1, "takes 0 positional arguments")],
)
def test_errors_come_back_with_their_name(function, said):
    check = exercises.functions("10")[2]
    replies = student.replies(function, check, 0, 1)
    assert said in check.check(handin.repeat(replies))


def test_what_a_function_writes_into_its_arguments_comes_back():
    given = np.zeros(3)
    reply = {"value": "null", "arguments": ["[7, 7, 7]"]}
    assert handin.repeat([reply])(given) is None and (given == 7).all()
