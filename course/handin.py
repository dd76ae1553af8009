"""Check handed-in notebooks: `python -m course check my_notebook.ipynb`, or a folder of them.

The notebook runs in a kernel of its own, and every function that an exercise asks for is called there; judged it is
here, by the checkers of this clone. Each notebook gets a score sheet as JSON; a class gets one table, scores.csv.
A sheet that is there, of the same notebook and the same checkers, is kept, so that a stopped class resumes.
"""

import ast
import csv
import hashlib
import io
import json
import math
import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat

from course import exercises, nbtools, solve, student
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder

OUT = nbtools.ROOT / "out" / "checked"
SECONDS, MEMORY_GIB = 600.0, 4.0
ANSWER_S = 20.0  # for each call of a student's function
STATUSES = ("right", "wrong", "not tried", "not judged")
UNTOUCHED = "nothing returned yet"  # what checkers say of a stub

Sheet = dict[str, Any]


@dataclass(frozen=True)
class Exercise:
    """An exercise with a checker."""

    number: str  #: such as 04.2
    checker: str  #: name in `course.exercises`
    function: str  #: name of the function that the student writes


def exercises_of(nb: nbformat.NotebookNode) -> list[Exercise]:
    """Return a notebook's exercises: the stubs that are handed to a checker."""
    found, number = [], ""
    for cell in nb.cells:
        if cell.cell_type == "markdown":
            number = [number, *re.findall(r"^\*\*(\d\d\.\d+) \(", cell.source, re.MULTILINE)][-1]
        elif names := [stub.name for stub in solve.stubs(cell.source)]:
            found += [Exercise(number, checker, names[0]) for checker in checkers_called(cell.source)]
    return found


def checkers_called(source: str) -> list[str]:
    """Return the names of the checkers that a cell calls; none if the cell is not Python."""
    try:
        calls = [node.func for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    except SyntaxError:
        return []
    names = (ast.unparse(call).partition("exercises.")[2] for call in calls)
    return [name for name in names if name.startswith("check_")]


def original_of(nb: nbformat.NotebookNode, path: Path) -> Path:
    """Return the course's notebook that a handed-in one began as, by the number in its title."""
    title = next((cell.source for cell in nb.cells if cell.cell_type == "markdown"), "")
    found = [original for original in nbtools.notebooks() if title.startswith(f"# {original.stem[:2]} ")]
    if not found:
        raise OmnistereoError(
            f"{path} begins with {title[:40]!r}; expected the title of a notebook of the course, such as "
            "'# 04 · ZNCC'. Leave the first cell as it was"
        )
    return found[0]


# --- One notebook -----------------------------------------------------------------------------------------


def check_notebook(path: Path, seconds: float = SECONDS, memory_gib: float = MEMORY_GIB) -> Sheet:
    """Run a handed-in notebook and judge its exercises; return the score sheet.

    Args:
        path: The notebook; it is read and never written.
        seconds: The time that it may take in all. A cell is interrupted after a third of it.
        memory_gib: The memory that its kernel may use.

    Raises:
        OmnistereoError: If it is not a notebook of the course.
    """
    started, nb = time.monotonic(), nbtools.read_notebook(path)
    original = original_of(nb, path)
    asked = exercises_of(nbformat.read(original, as_version=4))
    results, notes = {}, list(other_version(nb, asked))
    try:
        with student.running(seconds, memory_gib) as kernel:
            for number, cell in enumerate(nbtools.code_cells(nb), start=1):
                if said := kernel.run(cell.source, seconds / 3):
                    notes.append(f"code cell {number} stopped with {said}")
                for exercise in asked:  # now: a later cell may never end, or write over the function
                    if exercise.checker in checkers_called(cell.source):
                        results[exercise.number] = judge(kernel, exercise)
            for exercise in asked:
                if exercise.number not in results:
                    results[exercise.number] = judge(kernel, exercise)
    except student.Stopped as stopped:
        notes.append(f"stopped in code cell {number}: {stopped}")
    unjudged = {"status": "not judged", "said": notes[-1] if notes else ""}
    results = {exercise.number: results.get(exercise.number, unjudged) for exercise in asked}
    used = {"seconds": round(time.monotonic() - started, 1), "peak_gib": round(kernel.peak_gib, 2)}
    return {"notebook": original.stem, "exercises": results, "notes": notes} | used


def judge(kernel: student.Student, exercise: Exercise) -> dict[str, str]:
    """Return the status of an exercise and what this clone's checker says of the student's function."""
    if not kernel.has(exercise.function):
        return {"status": "not tried", "said": f"there is no function {exercise.function}"}
    spoken = io.StringIO()
    with redirect_stdout(spoken):
        getattr(exercises, exercise.checker)(kernel.function(exercise.function, ANSWER_S))
    said = spoken.getvalue().splitlines()[-1]
    status = "not tried" if said.startswith(UNTOUCHED) else "right" if said == "right" else "wrong"
    return {"status": status, "said": said}


def other_version(nb: nbformat.NotebookNode, asked: list[Exercise]) -> Iterator[str]:
    """Say where a notebook has other exercises than this clone's."""
    has = {name for cell in nbtools.code_cells(nb) for name in checkers_called(cell.source)}
    known = {exercise.checker for exercise in asked}
    if lacking := [exercise.number for exercise in asked if exercise.checker not in has]:
        yield f"does not call the checkers of {', '.join(lacking)}"
    if foreign := sorted(name for name in has - known if not hasattr(exercises, name)):
        yield f"of another version of the course: calls {', '.join(foreign)}, which this clone does not have"


def in_words(sheet: Sheet) -> str:
    """Return a score sheet as text."""
    lines = [f"{sheet['file']}: notebook {sheet['notebook']}, {sheet['seconds']} s, {sheet['peak_gib']} GiB"]
    for number, result in sheet["exercises"].items():
        said = "" if result["status"] == "right" else result["said"]
        lines.append(f"  {number}  {result['status']:<10}  {said.removeprefix('not yet: ')}".rstrip())
    lines += [f"  note: {note}" for note in sheet["notes"]]
    counts = Counter(result["status"] for result in sheet["exercises"].values())
    return "\n".join([*lines, "  " + ", ".join(f"{counts[status]} {status}" for status in STATUSES)])


# --- A class ----------------------------------------------------------------------------------------------


def check(path: Path, out: Path = OUT, seconds: float = SECONDS, memory_gib: float = MEMORY_GIB) -> list[Sheet]:
    """Check a notebook, or all below a folder; print the sheets and write them to `out`, a class's table as well.

    Raises:
        OmnistereoError: If a limit is not positive, there is no notebook, or if `path` is one and not of the course; in
            a folder, such a one gets a sheet without exercises, and the class goes on.
    """
    for name, limit in (("seconds", seconds), ("memory", memory_gib)):
        if not 0 < limit < math.inf:
            raise OmnistereoError(f"{name} is {limit:g}; expected a positive number. Leave --{name} out, or raise it")
    if not path.is_dir():
        return [sheet_of(path, path.name, make_folder(out), seconds, memory_gib)]
    names = [file.relative_to(path) for file in sorted(path.rglob("*.ipynb"))]
    names = [name for name in names if not any(part.startswith(".") for part in name.parts)]
    if not names:
        raise OmnistereoError(f"{path} holds no notebook: give a folder with .ipynb files, in any folders below it")
    sheets = []
    for name in names:
        try:
            sheets.append(sheet_of(path / name, name.as_posix(), out, seconds, memory_gib))
        except OmnistereoError as error:
            print(f"{name}: {error}")
            sheets.append({"file": name.as_posix(), "exercises": {}, "notes": [str(error)]})
    write_scores(out / "scores.csv", sheets)
    print(f"written: {out / 'scores.csv'}")
    return sheets


def sheet_of(path: Path, name: str, out: Path, seconds: float, memory_gib: float) -> Sheet:
    """Return a notebook's score sheet, the stored one if nothing has changed; print it and store it."""
    made_from = {"sha256": checksum(path), "checkers": checksum(*sorted(Path(exercises.__file__).parent.glob("*.py")))}
    stored = out / f"{name}.json"
    if stored.is_file():
        sheet = json.loads(stored.read_text(encoding="utf-8"))
        if made_from.items() <= sheet.items():
            print(in_words(sheet), flush=True)
            return sheet
    sheet = {"file": name, **made_from, **check_notebook(path, seconds, memory_gib)}
    print(in_words(sheet), flush=True)
    make_folder(stored.parent)
    with atomic_write(stored) as temporary:
        temporary.write_text(json.dumps(sheet, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return sheet


def checksum(*paths: Path) -> str:
    """Return the SHA-256 of some files' contents, one behind the other."""
    try:
        return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()
    except OSError as error:
        raise OmnistereoError(f"{error.filename} cannot be read: {error.strerror}. Check the path.") from None


def write_scores(path: Path, sheets: list[Sheet]) -> None:
    """Write the table of a class: a line for each notebook, a column for each exercise."""
    numbers = sorted({number for sheet in sheets for number in sheet["exercises"]})
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, ["file", "notebook", *STATUSES, *numbers, "notes"])
        table.writeheader()
        for sheet in sheets:
            results = {number: result["status"] for number, result in sheet["exercises"].items()}
            counts = Counter(results.values())
            row = {status: counts[status] for status in STATUSES} | results
            table.writerow(
                {
                    "file": sheet["file"],
                    "notebook": sheet.get("notebook", ""),
                    **row,
                    "notes": "; ".join(sheet["notes"]),
                }
            )
