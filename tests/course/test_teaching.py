"""The teacher's page: every notebook has its section, and every exercise that it names exists."""

import re

import nbformat
import pytest

from course import nbtools
from course.classroom import handin

PAGE = (nbtools.ROOT / "book" / "teaching.md").read_text(encoding="utf-8")
SECTIONS = {
    part.partition(" ")[0]: part for part in re.split(r"^## (?=\d)", PAGE, flags=re.MULTILINE)[1:]
}
NOTEBOOKS = {nbtools.number(nb): nbformat.read(nb, as_version=4) for nb in nbtools.notebooks()}


def numbers(nb):
    """The numbers of a notebook's exercises, the open ones too."""
    prose = "\n".join(cell.source for cell in nb.cells if cell.cell_type == "markdown")
    return re.findall(r"^\*\*(\d\d\.\d+) \(", prose, re.MULTILINE)


def test_every_notebook_has_a_section():
    assert list(SECTIONS) == list(NOTEBOOKS)


@pytest.mark.parametrize("number", NOTEBOOKS)
def test_a_section_grades_ten_points(number):
    assert SECTIONS[number].startswith(
        f"{number} · {NOTEBOOKS[number].metadata.omnistereo.title}\n"
    )
    assert sum(map(int, re.findall(r"^\| (\d+) \|", SECTIONS[number], re.MULTILINE))) == 10


@pytest.mark.parametrize("number", NOTEBOOKS)
def test_the_goals_are_tested_by_all_its_exercises(number):
    goals = SECTIONS[number].partition("**Afterwards")[2].partition("**Where")[0]
    asked = {exercise.number for exercise in handin.exercises_of(NOTEBOOKS[number])}
    assert {*re.findall(r"\d\d\.\d", goals), *re.findall(r"`(\w+)`", goals)} == asked


def test_every_exercise_that_it_names_exists():
    known = {number for nb in NOTEBOOKS.values() for number in numbers(nb)}
    assert set(re.findall(r"\b(?:0\d|1[0-7])\.\d\b", PAGE)) <= known
