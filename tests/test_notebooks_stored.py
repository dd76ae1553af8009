"""Guard: a notebook is stored run, in order, clean, short, and with every picture described.

A notebook without outputs would pass nbval with nothing compared, so this comes first.
"""

import nbtools
import pytest


@pytest.mark.parametrize("path", nbtools.notebooks(), ids=lambda path: path.stem)
def test_stored_as_it_should_be(path):
    assert nbtools.problems(path) == []


def test_the_course_begins():
    assert (nbtools.NOTEBOOKS / "00_quickstart.ipynb").is_file()


def test_all_notebooks_stay_small():
    assert sum(path.stat().st_size for path in nbtools.notebooks()) < 6_000_000


def test_the_readme_lists_them():
    readme = nbtools.README.read_text(encoding="utf-8")
    assert nbtools.with_table(readme, nbtools.notebooks()) == readme, "python tests/nbtools.py readme"


def test_the_readme_shows_the_first_picture_of_the_course():
    assert nbtools.PICTURE.read_bytes() == nbtools.first_picture(nbtools.notebooks()[0]), (
        "python tests/nbtools.py readme"
    )
    assert f"(notebooks/{nbtools.PICTURE.name})" in nbtools.README.read_text(encoding="utf-8")
