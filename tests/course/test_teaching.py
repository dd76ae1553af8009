"""The teacher's page: every notebook has its section, and every exercise that it names exists."""

import re

import nbformat
import pytest

from course import handin, nbtools, teaching

PAGE = (nbtools.ROOT / "book" / "teaching.md").read_text(encoding="utf-8")
SECTIONS = {part[:2]: part for part in re.split(r"^## ", PAGE, flags=re.MULTILINE) if part[:2].isdigit()}
NOTEBOOKS = {path.stem[:2]: nbformat.read(path, as_version=4) for path in nbtools.notebooks()}
PARTS = ["**Notebook:**", "**Before:**", "**Time:**", "**Afterwards a student can**", "**Where they get stuck.**",
         "<!-- stuck", "**For the board**", "**Assignment.**", "| points | for |"]  # fmt: skip


def numbers(nb):
    """The numbers of a notebook's exercises, the open ones too."""
    prose = "\n".join(cell.source for cell in nb.cells if cell.cell_type == "markdown")
    return re.findall(r"^\*\*(\d\d\.\d+) \(", prose, re.MULTILINE)


def test_every_notebook_has_a_section():
    assert list(SECTIONS) == list(NOTEBOOKS)


@pytest.mark.parametrize("number", NOTEBOOKS)
def test_a_section_has_all_its_parts(number):
    section = SECTIONS[number]
    assert section.startswith(f"{number} · {NOTEBOOKS[number].metadata.omnistereo.title}\n")
    places = [section.find(part) for part in PARTS]
    assert -1 not in places and places == sorted(places)
    assert f"<!-- stuck {number} -->" in section
    assert sum(map(int, re.findall(r"^\| (\d+) \|", section, re.MULTILINE))) == 10
    assert len(re.findall(r"^- \*.+\?\* \S", section, re.MULTILINE)) >= 3  # questions, each with its answer


@pytest.mark.parametrize("number", NOTEBOOKS)
def test_the_goals_are_tested_by_all_its_exercises(number):
    goals = SECTIONS[number].partition("**Afterwards")[2].partition("**Where")[0]
    asked = {exercise.number for exercise in handin.exercises_of(NOTEBOOKS[number])}
    assert set(re.findall(r"\d\d\.\d", goals)) == asked


def test_every_exercise_that_it_names_exists():
    known = {number for nb in NOTEBOOKS.values() for number in numbers(nb)}
    assert set(re.findall(r"\b(?:0\d|1[0-3])\.\d\b", PAGE)) <= known


def test_the_plans_lead_through_the_course():
    weeks, afternoons = (
        PAGE.partition(head)[2].partition("\n## ")[0] for head in ("## Twelve weeks", "## Four afternoons")
    )
    assert re.findall(r"^\| (\d+) \|", weeks, re.MULTILINE) == [str(week) for week in range(1, 13)]
    assert set(re.findall(r"notebooks/(\d\d)_", weeks)) == set(NOTEBOOKS)
    assert re.findall(r"^\| (\d): ", afternoons, re.MULTILINE) == ["1", "2", "3", "4"]


def test_the_mistakes_are_those_of_the_checkers():
    parts = teaching.stuck()
    assert list(parts) == [f"stuck {number}" for number in NOTEBOOKS]
    for part, nb in zip(parts.values(), NOTEBOOKS.values(), strict=True):
        assert re.findall(r"^- \*\*(\S+)\*\*\n  - \S", part, re.MULTILINE) == [
            e.number for e in handin.exercises_of(nb)
        ]
    assert "a pair that does not see the ray must not spoil the others" in parts["stuck 04"]
