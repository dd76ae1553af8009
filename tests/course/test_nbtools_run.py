"""Notebooks are run, and stored only if nothing is wrong."""

import os

import nbformat
import pytest
from notebook_cells import DRAWING, FACTS, SETUP, SLIDER, code, framed, notebook, write

from course import kernels, nbtools, rules
from course.figures.captions import captions


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """A doctor that is always content: the setup cell is not what is tested here."""
    (tmp_path / "sitecustomize.py").write_text(
        "from course import doctor\n\ndoctor.doctor = lambda short: print('OK')\n", encoding="utf-8"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(nbtools.ROOT)]))
    return tmp_path


@pytest.mark.slow
def test_run_stores_a_notebook_that_the_guard_and_a_second_run_accept(stand_in):
    nb = framed(*map(code, [SETUP, DRAWING, SLIDER, "2 * 0.25"]))
    path = write(stand_in / "tiny.ipynb", nb)
    assert kernels.run([path])
    first = path.read_text(encoding="utf-8")
    assert rules.lint([path])
    assert kernels.run([path])
    assert path.read_text(encoding="utf-8") == first
    cells = nbtools.code_cells(nbformat.reads(first, as_version=4))
    assert [cell.execution_count for cell in cells] == [1, 2, 3, 4]
    assert cells[1].outputs[0].metadata["image/png"]["alt"] == captions()["04 one ray"]["alt"]
    caption = captions()["04 one ray"]["caption"]
    assert cells[1].outputs[1].data["text/markdown"] == f"*Figure:* {caption}"
    assert sorted(file.name for file in stand_in.glob("*.ipynb*")) == ["tiny.ipynb"]


@pytest.mark.parametrize(
    ("source", "budget", "said"),
    [("1 / 0", 60, "ZeroDivisionError"), ("pass", 0, "its budget is 0 s")],
)
def test_run_keeps_the_file_when_something_is_wrong(stand_in, capsys, source, budget, said):
    nb = notebook(code(SETUP), code(source), omnistereo=FACTS | {"budget_s": budget})
    path = write(stand_in / "tiny.ipynb", nb)
    before = path.read_bytes()
    assert not kernels.run([path])
    assert said in capsys.readouterr().err
    assert path.read_bytes() == before
    assert sorted(file.name for file in stand_in.glob("*.ipynb*") if not file.is_dir()) == [
        "tiny.ipynb"
    ]
