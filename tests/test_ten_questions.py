"""The ten questions of CONTRIBUTING.md: each place exists, and what is to be read there is as short as the page says.

`pytest -s tests/test_ten_questions.py` prints the lines.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ([^|]+\?) \| ([^|]+) \| (\d+) lines, (\d+) files? \|$", PAGE, re.MULTILINE)


def lines_of(file, name):
    """Count the lines of a function, class, method (Class.method) or assigned name, with its docstring."""
    body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    *classes, last = name.split(".")
    for part in classes:
        body = next(node.body for node in body if isinstance(node, ast.ClassDef) and node.name == part)
    for node in body:
        named = [getattr(node, "name", "")] + [getattr(target, "id", "") for target in getattr(node, "targets", [])]
        if last in named:
            first = min([node.lineno, *(decorator.lineno for decorator in getattr(node, "decorator_list", []))])
            return node.end_lineno - first + 1
    raise AssertionError(f"{file} has no {name}")


def test_there_are_ten():
    assert len(ROWS) == 10


@pytest.mark.parametrize(("question", "places", "most", "files"), ROWS, ids=[row[0] for row in ROWS])
def test_an_answer_is_short(question, places, most, files):
    read = {}
    for place in re.findall(r"`([^`]+)`", places):
        if place.endswith(".py"):
            file = place
            read[file] = 0
        else:
            read[file] += lines_of(file, place)
    print(f"\n{question} {sum(read.values())} lines in {len(read)} files: {read}")
    assert sum(read.values()) <= int(most) and len(read) <= int(files)
