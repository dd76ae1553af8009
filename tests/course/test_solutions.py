"""The solution notebooks have the right answers for the stubs, and nothing else changed."""

import re
import runpy

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from scene import refused

from course import nbtools
from course.classroom import solve

STORED = {path: nbformat.read(path, as_version=4) for path in nbtools.notebooks()}


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.stem)
def test_a_solution_notebook_differs_in_the_solved_cells_alone(path):
    stored = STORED[path]
    nb = solve.solve(stored, solve.open_answers(nbtools.number(path)))
    nbformat.validate(nb)
    assert nb.metadata == stored.metadata
    for cell, before in zip(nb.cells, stored.cells, strict=True):
        stubbed = before.cell_type == "code" and any(solve.stubs(before.source))
        assert (cell != before) == stubbed
        assert not stubbed or not (any(solve.stubs(cell.source)) or cell.outputs)


# --- The tool, on a notebook of its own


def double(x):
    # Twice.
    return 2 * x


def half(x):
    return x / 2


STUB = "def double(x):\n    return ...\n\n\nprint(double(2))"


@pytest.fixture
def course(tmp_path):
    """The path of a notebook with one stub."""
    printed = new_output("stream", name="stdout", text="Ellipsis\n")
    stub = new_code_cell(STUB, outputs=[printed], execution_count=1)
    cells = [new_markdown_cell("Double it."), stub]
    path = tmp_path / "00_tiny.ipynb"
    nbformat.write(new_notebook(cells=cells), path)
    return path


def test_solution_keeps_its_comments_and_the_cell_what_is_around_it(course):
    cell = solve.solve(nbformat.read(course, as_version=4), {"double": double}).cells[1]
    assert cell.source == "def double(x):\n    # Twice.\n    return 2 * x\n\n\nprint(double(2))"
    assert cell.outputs == [] and cell.execution_count is None


def test_two_stubs_in_a_cell():
    source = STUB + "\n\n\ndef half(x):\n    y = x\n    return ..."
    assert solve.solved(source, {"double": double, "half": half}).endswith(
        "    return 2 * x\n\n\nprint(double(2))\n\n\ndef half(x):\n    return x / 2"
    )


def test_stub_without_an_answer_is_named(course):
    with refused("the stub double has no answer in course/exercises; there are half"):
        solve.solve(nbformat.read(course, as_version=4), {"half": half})


@pytest.fixture
def tiny(course, tmp_path, monkeypatch):
    """A clone with this one notebook, whose checker wants twice the number."""
    monkeypatch.setattr(solve.nbtools, "ROOT", tmp_path)
    monkeypatch.setattr(solve.nbtools, "notebooks", lambda: [course])
    monkeypatch.setattr(solve, "OUT", tmp_path / "out" / "solutions")
    nb = nbformat.read(course, as_version=4)
    found = "'right, we go on with yours.' if double(2) == 4 else 'not yet: twice'"
    check = f"class nb00:\n    check_it = lambda double: print('double:', {found})"
    nb.cells[1].source = f"{check}\n\n\n{STUB.replace('print(double(2))', 'nb00.check_it(double)')}"
    other = "class tools:\n    check_rig = print\n\n\ntools.check_rig('no checker of the course')"
    nb.cells.append(nbformat.v4.new_code_cell(other))
    nbformat.write(nb, course)
    (tmp_path / "data_samples").mkdir()
    return tmp_path


def test_command_writes_notebooks_that_ran_and_find_the_data(tiny, monkeypatch, capsys):
    monkeypatch.setattr(solve, "open_answers", lambda number: {"double": double})
    solve.main([])
    assert capsys.readouterr().out.endswith("s\nThe notebooks with solutions: out/solutions\n")
    nb = nbformat.read(tiny / "out" / "solutions" / "00_tiny.ipynb", as_version=4)
    nbformat.validate(nb)
    assert nb.cells[1].outputs[0].text == "double: right, we go on with yours.\n"
    assert (tiny / "out" / "solutions" / ".." / "data_samples").resolve() == tiny / "data_samples"


@pytest.mark.parametrize(
    ("source", "said"), [("return x", "not yet: twice"), ("return x / 0", "ZeroDivisionError")]
)
def test_command_writes_no_wrong_solution(tiny, monkeypatch, source, said):
    (tiny / "wrong.py").write_text(f"def double(x):\n    {source}\n", encoding="utf-8")
    wrong = runpy.run_path(str(tiny / "wrong.py"))["double"]
    monkeypatch.setattr(solve, "open_answers", lambda number: {"double": wrong})
    with refused(said):
        solve.main([])
    assert not (tiny / "out" / "solutions" / "00_tiny.ipynb").exists()


def test_all_that_the_notebooks_look_up_lies_beside_the_solutions():
    text = "".join(path.read_text(encoding="utf-8") for path in STORED)
    assert set(re.findall(r'\\"\.\./(\w+)', text)) - {"out"} == set(solve.LOOKED_UP)


def test_command_runs_what_is_asked_for(tiny, monkeypatch, capsys):
    monkeypatch.setattr(solve, "open_answers", lambda number: {"double": double})
    with refused("there is no notebook 07, xx; expected one of 00"):
        solve.main(["00", "07", "xx"])
    assert not (tiny / "out").exists()
    solve.main(["00"])
    assert (tiny / "out" / "solutions" / "00_tiny.ipynb").exists()
