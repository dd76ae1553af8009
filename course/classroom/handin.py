"""Check handed-in notebooks: `python -m course check my_notebook.ipynb`, or a folder of them.

The notebook runs in a process of its own (`student`), which brings back what the student's
functions answer; they are judged here, by the checkers of this clone. Each notebook gets a score
sheet as JSON; a class gets one table, scores.csv. A sheet of the same notebook and the same
checkers is kept, so that a stopped class resumes.
"""

import csv
import hashlib
import json
import math
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import nbformat
import numpy as np

from course import exercises, nbtools
from course.classroom import student
from course.exercises.opened import NOT_WRITTEN, RIGHT, Open
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder, read_bytes, write_text

OUT = nbtools.ROOT / "out" / "checked"
SECONDS, MEMORY_GIB = 600.0, 4.0
ANSWER_S = 20.0  # for each call of a student's function
MAX_BYTES = 32 * 2**20  # of a notebook
MAX_NOTES = 50
MAX_ARRAY_BYTES = 64 * 2**20  # of an answer
STATUSES = ("right", "wrong", "not tried", "not judged")
# module, checker, function
CHECKED = re.compile(r"\b(?:exercises|(nb\d\d))\.(check_\w+)\((\w+)\)")
NUMBER = re.compile(r"^\*\*(\d\d\.\d+) \(", re.MULTILINE)  # **04.2 (medium).**
ENVIRONMENT = (
    Path(sys.prefix),
    *(nbtools.ROOT / name for name in ("course", "omnistereo_lib", "omnistereo_tools")),
)

Sheet = dict[str, Any]


@dataclass(frozen=True)
class Exercise:
    """A function that a student writes and a checker tries."""

    number: str  #: such as 04.2; the function's name where it has no number
    checker: str  #: where it is, below `course.exercises`
    function: str  #: its name

    @property
    def open(self) -> Open:
        """The checker itself."""
        return resolve_name(f"course.exercises.{self.checker}")


def exercises_of(nb: nbformat.NotebookNode) -> list[Exercise]:
    """Return the exercises of a notebook: the functions that it hands to a checker."""
    found, number = [], ""
    for cell in nb.cells:
        if cell.cell_type == "markdown":
            number = [number, *NUMBER.findall(cell.source)][-1]
        else:
            for module, checker, function in CHECKED.findall(cell.source):
                found.append(
                    Exercise(number or function, f"{module}.{checker}".lstrip("."), function)
                )
    return found


def read_cells(path: Path) -> list[tuple[str, str]]:
    """Return type and source of a handed-in notebook's cells; outputs are not looked at."""
    content = read_bytes(path, MAX_BYTES)
    try:
        return [(c["cell_type"], "".join(c["source"])) for c in json.loads(content)["cells"]]
    except Exception as error:  # JSON, its nesting, its keys
        kind = type(error).__name__
        raise OmnistereoError(
            f"{path} is not a notebook ({kind}): save it again in JupyterLab"
        ) from None


def original_of(cells: list[tuple[str, str]], path: Path) -> Path:
    """Return the course's notebook that a handed-in one began as, by the number in its title."""
    title = next((source for kind, source in cells if kind == "markdown"), "")
    known = nbtools.notebooks()
    found = [path for path in known if title.startswith(f"# {nbtools.number(path)} ")]
    if not found:
        raise OmnistereoError(
            f"{path} begins with {title[:40]!r}; expected the title of a notebook of the course,"
            " such as '# 04 · ZNCC'. Leave its first cell as it was"
        )
    return found[0]


# --- One notebook


def check_notebook(path: Path, seconds: float = SECONDS, memory_gib: float = MEMORY_GIB) -> Sheet:
    """Run a handed-in notebook and judge its exercises; return the score sheet.

    Args:
        path: The notebook; it is read and never written.
        seconds: The time that it may take in all. A cell is interrupted after a third of it.
        memory_gib: The memory that all its processes may use together.

    Raises:
        OmnistereoError: If it is not a notebook of the course, or the limits leave no room for any
            cell.
    """
    cells = read_cells(path)
    original = original_of(cells, path)
    asked = exercises_of(nbtools.read_notebook(original))
    code = [source for kind, source in cells if kind == "code"]
    seed = int(checksum(path)[:8], 16)  # cases that its author has not seen, the same at each check
    checkers = {exercise.function: exercise.checker for exercise in asked}
    task: dict[str, Any] = {"cells": code, "exercises": checkers, "seed": seed}
    task |= {"cell_s": seconds / 3, "answer_s": ANSWER_S}
    ran = student.run(task, seconds, memory_gib)
    if ran.stopped and not ran.records:
        raise OmnistereoError(f"no cell can run: {ran.stopped}. Raise --seconds or --memory")
    said = [record.get("said") for record in ran.records if "cell" in record]
    notes = list(other_version(code, asked))
    notes += [f"code cell {k} stopped with {text}" for k, text in enumerate(said, 1) if text]
    notes = notes[:MAX_NOTES]
    notes += [f"left threads behind: {left}" for one in ran.records if (left := one.get("threads"))]
    if ran.left_mib >= 1:
        notes.append(f"left {ran.left_mib:.0f} MiB of files behind, which were removed")
    if ran.stopped:
        where = f"in code cell {len(said) + 1}" if len(said) < len(code) else "after its last cell"
        notes.append(f"stopped {where}: {ran.stopped}")
    named = [record for record in ran.records if isinstance(record.get("function"), str)]
    answers = {record["function"]: record.get("replies") for record in named}
    results = {exercise.number: judge(exercise, seed, answers, ran.stopped) for exercise in asked}
    used = {"seconds": round(ran.seconds, 1), "peak_gib": round(ran.peak_gib, 2)}
    sheet = {"notebook": original.stem, "exercises": results}
    return sheet | {"notes": list(map(printable, notes))} | used


def judge(exercise: Exercise, seed: int, answers: dict[Any, Any], stopped: str) -> dict[str, str]:
    """Return the status of an exercise and what this clone's checker says of the answers."""
    if exercise.function not in answers:
        if stopped:
            return {"status": "not judged", "said": stopped}
        return {"status": "not tried", "said": f"there is no function {exercise.function}"}
    said = exercise.open.check(repeat(answers[exercise.function]), seed)
    status = "not tried" if said.startswith(NOT_WRITTEN) else "right" if said == RIGHT else "wrong"
    return {"status": status, "said": printable(" ".join(said.split()))}


def repeat(replies: Any) -> Callable[..., Any]:
    """Return a function that answers as the student's did: value, exception, written arrays."""
    left = iter(replies)

    def answer(*arguments: Any) -> Any:
        reply = next(left, {"error": "RuntimeError", "text": "no answer"})
        if "error" in reply:  # by its name, but as an exception of no other use
            raise type(reply["error"], (Exception,), {"__module__": "builtins"})(reply["text"])
        for argument, after in zip(arguments, reply["arguments"], strict=True):
            array = argument.detach().numpy() if hasattr(argument, "detach") else argument
            if isinstance(array, np.ndarray):
                array[...] = read_value(after)
        value = read_value(reply["value"])
        if reply.get("differentiable"):
            import torch

            return torch.tensor(value, dtype=torch.float64, requires_grad=True)
        return (
            type(value["type"], (), {})() if isinstance(value, dict) and "type" in value else value
        )

    return answer


def read_value(text: str) -> Any:
    """Return a value in JSON; raises a `MemoryError` if, as an array, it took far more than as
    text.

    An array of texts gives each of its elements the room of the longest.
    """
    value = json.loads(text)
    count, longest, left = 0, 1, [value]
    while left:
        part = left.pop()
        if isinstance(part, list | dict):
            left += part.values() if isinstance(part, dict) else part
        elif isinstance(part, str):
            longest = max(longest, len(part))
        count += 1
    if 4 * count * longest > MAX_ARRAY_BYTES:
        raise MemoryError(f"an answer that would take {4 * count * longest >> 20} MiB as an array")
    return value


def other_version(code: list[str], asked: list[Exercise]) -> Iterator[str]:
    """Say where a notebook has other exercises than this clone's."""
    has = {checker for source in code for _, checker, _ in CHECKED.findall(source)}
    known = {exercise.checker.rpartition(".")[2]: exercise.number for exercise in asked}
    if lacking := [number for checker, number in known.items() if checker not in has]:
        yield f"does not call the checkers of {', '.join(lacking)}"
    if foreign := sorted(has - set(known)):
        yield (
            f"of another version of the course: calls {', '.join(foreign)}, which the notebook here"
            " does not"
        )


def in_words(sheet: Sheet) -> str:
    """Return a score sheet as text."""
    used = f"{sheet['seconds']} s, {sheet['peak_gib']} GiB"
    lines = [f"{sheet['file']}: notebook {sheet['notebook']}, {used}"]
    width = max(map(len, sheet["exercises"]), default=0)
    for number, result in sheet["exercises"].items():
        said = "" if result["status"] == "right" else result["said"]
        lines.append(
            f"  {number:<{width}}  {result['status']:<10} "
            f" {said.removeprefix('not yet: ')}".rstrip()
        )
    lines += [f"  note: {note}" for note in sheet["notes"]]
    counts = Counter(result["status"] for result in sheet["exercises"].values())
    return "\n".join(
        [*lines, "  " + ", ".join(f"{counts[status]} {status}" for status in STATUSES)]
    )


def printable(text: str) -> str:
    """Return a text as one line of at most 500 printable characters, others escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:500])[:500]


# --- A class


def check(
    path: Path, out: Path = OUT, seconds: float = SECONDS, memory_gib: float = MEMORY_GIB
) -> list[Sheet]:
    """Check a notebook, or all below a folder; print the sheets and write them to `out`, a class's
    table as well.

    Raises:
        OmnistereoError: If a limit is not positive, there is no notebook, or if `path` is one and
            not of the course; in a folder, such a one gets a sheet without exercises, and the class
            goes on.
    """
    for what, limit in (("seconds", seconds), ("memory", memory_gib)):
        if not 0 < limit < math.inf:
            raise OmnistereoError(
                f"{what} is {limit:g}; expected a positive number. Leave --{what} out, or raise it"
            )
    if os.name != "posix":
        raise OmnistereoError(
            "limits need Linux or macOS. Check hand-ins in a container; book/teaching.md says how"
        )
    is_class = path.is_dir()
    folder = path if is_class else path.parent
    names = (
        [file.relative_to(path) for file in sorted(path.rglob("*.ipynb"))]
        if is_class
        else [Path(path.name)]
    )
    names = [
        name
        for name in names
        if not is_class or not any(part.startswith(".") for part in name.parts)
    ]
    if not names:
        raise OmnistereoError(
            f"{path} holds no notebook: give a folder with .ipynb files, in any folders below it"
        )
    make_folder(out)
    if is_class:
        write_scores(out / "scores.csv", [])  # it is there whatever comes
    # before any code can write one
    kept = {name: stored_sheet(out / f"{name}.json", folder / name) for name in names}
    environment, sheets = last_changes(), []
    handed_in: dict[Path, str] = {name: content_of(folder / name) for name in names}
    spoiled: dict[Path, list[str]] = {}
    for name in names:
        try:
            if not (sheet := kept[name]):
                checked = check_notebook(folder / name, seconds, memory_gib)
                sheet = {"file": printable(str(name)), **made_from(folder / name), **checked}
                sheet["notes"] += spoiled.get(name, [])
                for other in rewritten(folder, handed_in):
                    sheet["notes"].append(
                        printable(f"{other} was rewritten while this one ran. Hand both in again")
                    )
                    spoiled[other] = [
                        printable(f"was rewritten while {name} ran. Hand both in again")
                    ]
                store_sheet(out / f"{name}.json", sheet, environment)
            say(in_words(sheet))
        except Exception as error:  # whatever a notebook of a class raises becomes its sheet
            if not is_class:
                raise
            note = printable(str(error) or type(error).__name__)
            sheet = {"file": printable(str(name)), "exercises": {}, "notes": [note]}
            say(f"{sheet['file']}: {note}")
        sheets.append(sheet)
        if is_class:
            write_scores(out / "scores.csv", sheets)
    if is_class:
        say(f"written: {out / 'scores.csv'}")
    return sheets


def content_of(path: Path) -> str:
    """Return the checksum of a hand-in; nothing if it cannot be read."""
    with suppress(OmnistereoError):
        return checksum(path)
    return ""


def rewritten(folder: Path, handed_in: dict[Path, str]) -> list[Path]:
    """Return the hand-ins that are not as they were; from now on they are."""
    now = {name: content_of(folder / name) for name in handed_in}
    others = [name for name in handed_in if now[name] != handed_in[name]]
    handed_in |= now
    return others


def say(text: str) -> None:
    """Print a text at once, in the letters that the terminal has."""
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)


def made_from(path: Path) -> dict[str, str]:
    """Return the checksums of a notebook and of the checkers, on which its sheet depends."""
    return {
        "sha256": checksum(path),
        "checkers": checksum(*sorted(Path(exercises.__file__).parent.glob("*.py"))),
    }


def checksum(*paths: Path) -> str:
    """Return the SHA-256 of some files' contents, one behind the other."""
    return hashlib.sha256(b"".join(read_bytes(path, MAX_BYTES) for path in paths)).hexdigest()


def stored_sheet(stored: Path, path: Path) -> Sheet | None:
    """Return the stored sheet of a notebook if it is whole, of this notebook and checkers."""
    with suppress(Exception):  # it may be damaged in any way
        sheet = json.loads(read_bytes(stored))
        if in_words(sheet) and made_from(path).items() <= sheet.items():
            return sheet
    return None


def store_sheet(stored: Path, sheet: Sheet, environment: set[tuple[str, int]]) -> None:
    """Store a sheet, unless the environment has changed; if it cannot be, the sheet says so."""
    if changed := sorted(environment ^ last_changes()):
        sheet["notes"].append(
            printable(f"the environment has changed: {changed[0][0]}. Install it again, then check")
        )
        return
    try:
        make_folder(stored.parent)
        write_text(stored, json.dumps(sheet, indent=1, ensure_ascii=False) + "\n")
    except OmnistereoError as error:
        sheet["notes"].append(printable(str(error)))


def last_changes() -> set[tuple[str, int]]:
    """Return every file, installed or of the clone, with the time of its last change."""
    found, folders = set(), list(map(str, ENVIRONMENT))
    for folder in folders:  # grows
        for entry in os.scandir(folder):
            if entry.is_dir(follow_symlinks=False):
                folders += [entry.path] if entry.name != "__pycache__" else []
            else:
                found.add((entry.path, entry.stat(follow_symlinks=False).st_ctime_ns))
    return found


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
            row |= {
                "file": sheet["file"],
                "notebook": sheet.get("notebook", ""),
                "notes": "; ".join(sheet["notes"]),
            }
            table.writerow({key: no_formula(value) for key, value in row.items()})


def no_formula(cell: str | int) -> str | int:
    """Return a cell as a spreadsheet should show it: with an apostrophe before a formula."""
    return f"'{cell}" if str(cell).startswith(("=", "+", "-", "@")) else cell
