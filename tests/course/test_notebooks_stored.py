"""Guard: a notebook is stored run, in order, clean, short, and with every picture described.

A notebook without outputs would pass nbval with nothing compared, so this comes first.
"""

import re
from itertools import pairwise

import nbformat
import pytest

from course import nbtools, rules
from course.figures.captions import captions

TEMPLATE = nbtools.ROOT / "course" / "template.ipynb"
each = pytest.mark.parametrize("path", nbtools.notebooks(), ids=lambda path: path.stem)


@pytest.mark.parametrize("path", [*nbtools.notebooks(), TEMPLATE], ids=lambda path: path.stem)
def test_stored_as_it_should_be(path):
    assert rules.problems(nbtools.read_text(path)) == []


@each
def test_the_path_leads_on(path):
    following = dict(pairwise(nbtools.notebooks())).get(path)
    opening = nbformat.read(path, as_version=4).cells[0].source
    assert not following or re.search(
        rf"\*\*Next:\*\* \[{nbtools.number(following)} · [^]]+\]\({following.name}\)", opening
    )


@each
def test_exercises_are_numbered_and_the_open_one_comes_last(path):
    cells = nbformat.read(path, as_version=4).cells
    prose = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    numbers = re.findall(r"^\*\*(\d\d\.\d+)\b", prose, re.MULTILINE)
    assert numbers == [f"{nbtools.number(path)}.{k}" for k in range(1, len(numbers) + 1)]


def test_every_caption_belongs_to_one_figure():
    text = "".join(path.read_text(encoding="utf-8") for path in [*nbtools.notebooks(), TEMPLATE])
    assert sorted(re.findall(r'show\(.*, \\"([^"]*)\\"\)', text)) == sorted(captions())
