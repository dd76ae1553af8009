"""Guard: a notebook is stored run, in order, clean, short, and with every picture described.

A notebook without outputs would pass nbval with nothing compared, so this comes first.
"""

import ast
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


def lines(source):
    """Lines of code without comments, docstrings and imports, as Python itself writes them."""
    tree = ast.parse(source)
    tree.body = [n for n in tree.body if not isinstance(n, ast.Import | ast.ImportFrom)]
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and ast.get_docstring(node):
            node.body = node.body[1:]
    return len(ast.unparse(tree).split("\n"))


def test_of_the_code_that_is_open_students_write_a_fifth():
    written = given = 0
    for nb in map(nbtools.read_notebook, nbtools.notebooks()):
        written += sum(lines(function.source) - 1 for function in nbtools.open_functions(nb))
        folded = nbtools.drawing_cells(nb)
        given += sum(lines(c.source) for c in nbtools.code_cells(nb) if c not in folded)
        assert max(lines(function.source) - 1 for function in nbtools.open_functions(nb)) >= 9
    assert written / (written + given) >= 0.2
