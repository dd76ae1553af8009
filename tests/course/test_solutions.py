"""Every exercise has one solution, which its checker calls right, and the solution notebooks add nothing else."""

import ast
import inspect
import re
import runpy

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from course import nbtools, solve
from omnistereo_lib.errors import OmnistereoError

STORED = {path: nbformat.read(path, as_version=4) for path in nbtools.notebooks()}
EXERCISES = [
    pytest.param(path, cell, id=f"{nbtools.number(path)} {next(solve.stubs(cell.source)).name}")
    for path, nb in STORED.items()
    for cell in nbtools.code_cells(nb)
    if any(stub.name in solve.ANSWERS for stub in solve.stubs(cell.source))
]


def imported(path):
    """What a reader has at the exercises: the modules and names that the notebook imports."""
    nodes = [node for cell in nbtools.code_cells(STORED[path]) for node in ast.parse(cell.source).body]
    imports = [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    namespace = {}
    exec(compile(ast.Module(imports, type_ignores=[]), path.name, "exec"), namespace)
    return namespace


@pytest.mark.parametrize(("path", "cell"), EXERCISES)
def test_solved_cell_is_right(path, cell, capsys):
    exec(solve.solved(cell.source, solve.ANSWERS), imported(path))
    assert capsys.readouterr().out == "right\n"


@pytest.mark.parametrize(("path", "cell"), EXERCISES)
def test_students_cell_asks_for_an_answer(path, cell, capsys):
    exec(cell.source, imported(path))
    said = capsys.readouterr().out
    assert said.startswith("nothing returned yet")
    assert [output.text for output in cell.outputs] == [said]


@pytest.mark.parametrize(("path", "cell"), EXERCISES)
def test_solution_takes_what_its_stub_takes(path, cell):
    (stub,) = solve.stubs(cell.source)
    (solution,) = ast.parse(inspect.getsource(solve.ANSWERS[stub.name])).body
    assert ast.unparse(solution.args) == ast.unparse(stub.args)


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.stem)
def test_every_call_of_a_checker_has_its_stub(path):
    """A stub of another form would stay in the solution notebook as it is."""
    for cell in nbtools.code_cells(STORED[path]):
        handed = [
            ast.unparse(node.args[0])
            for node in ast.walk(ast.parse(cell.source))
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("exercises.check_")
        ]
        assert handed == [stub.name for stub in solve.stubs(cell.source) if stub.name in solve.ANSWERS]


def test_solution_notebooks_differ_in_the_solved_cells_alone():
    notebooks = solve.solve_all(list(STORED), solve.ANSWERS)
    assert notebooks.keys() == STORED.keys()
    for path, nb in notebooks.items():
        nbformat.validate(nb)
        stored = STORED[path]
        assert nb.metadata == stored.metadata
        for cell, before in zip(nb.cells, stored.cells, strict=True):
            stubbed = before.cell_type == "code" and any(solve.stubs(before.source))
            assert (cell != before) == stubbed
            if stubbed:
                assert not any(solve.stubs(cell.source)) and not cell.outputs
                if "exercises.check_" in before.source:
                    assert cell.source.splitlines()[-1] == before.source.splitlines()[-1]  # the checker's call


# --- The tool, on a notebook of its own ---------------------------------------------------------------------


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
    cells = [new_markdown_cell("Double it."), new_code_cell(STUB, outputs=[printed], execution_count=1)]
    path = tmp_path / "00_tiny.ipynb"
    nbformat.write(new_notebook(cells=cells), path)
    return path


def test_solution_keeps_its_comments_and_the_cell_what_is_around_it(course):
    (nb,) = solve.solve_all([course], {"double": double}).values()
    cell = nb.cells[1]
    assert cell.source == "def double(x):\n    # Twice.\n    return 2 * x\n\n\nprint(double(2))"
    assert cell.outputs == [] and cell.execution_count is None


def test_two_stubs_in_a_cell():
    source = STUB + "\n\n\ndef half(x):\n    y = x\n    return ..."
    assert solve.solved(source, {"double": double, "half": half}).endswith(
        "    return 2 * x\n\n\nprint(double(2))\n\n\ndef half(x):\n    return x / 2"
    )


def test_stub_without_a_solution_is_named(course):
    with pytest.raises(OmnistereoError, match="the stub double has no solution; there are half"):
        solve.solve_all([course], {"half": half})


@pytest.fixture
def tiny(course, tmp_path, monkeypatch):
    """A clone with this one notebook, whose checker wants twice the number."""
    monkeypatch.setattr(solve.nbtools, "ROOT", tmp_path)
    monkeypatch.setattr(solve.nbtools, "notebooks", lambda: [course])
    monkeypatch.setattr(solve, "OUT", tmp_path / "out" / "solutions")
    nb = nbformat.read(course, as_version=4)
    check = "class exercises:\n    check_it = lambda double: print('right' if double(2) == 4 else 'not yet: twice')"
    nb.cells[1].source = f"{check}\n\n\n{STUB.replace('print(double(2))', 'exercises.check_it(double)')}"
    nbformat.write(nb, course)
    (tmp_path / "data_samples").mkdir()
    return tmp_path


def test_command_writes_notebooks_that_ran_and_find_the_data(tiny, monkeypatch, capsys):
    monkeypatch.setattr(solve, "ANSWERS", {"double": double})
    solve.main([])
    assert capsys.readouterr().out.endswith("s\nThe notebooks with solutions: out/solutions\n")
    nb = nbformat.read(tiny / "out" / "solutions" / "00_tiny.ipynb", as_version=4)
    nbformat.validate(nb)
    assert nb.cells[1].outputs[0].text == "right\n"
    assert (tiny / "out" / "solutions" / ".." / "data_samples").resolve() == tiny / "data_samples"


@pytest.mark.parametrize(("source", "said"), [("return x", "not yet: twice"), ("return x / 0", "ZeroDivisionError")])
def test_command_writes_no_wrong_solution(tiny, monkeypatch, source, said):
    (tiny / "wrong.py").write_text(f"def double(x):\n    {source}\n", encoding="utf-8")
    monkeypatch.setattr(solve, "ANSWERS", {"double": runpy.run_path(str(tiny / "wrong.py"))["double"]})
    with pytest.raises(OmnistereoError, match=said):
        solve.main([])
    assert not (tiny / "out" / "solutions" / "00_tiny.ipynb").exists()


def test_all_that_the_notebooks_look_up_lies_beside_the_solutions():
    text = "".join(path.read_text(encoding="utf-8") for path in STORED)
    assert set(re.findall(r'\\"\.\./(\w+)', text)) - {"out"} == set(solve.LOOKED_UP)


def test_command_runs_what_is_asked_for(tiny, monkeypatch, capsys):
    monkeypatch.setattr(solve, "ANSWERS", {"double": double})
    with pytest.raises(OmnistereoError, match="there is no notebook 07, xx; expected one of 00"):
        solve.main(["00", "07", "xx"])
    assert not (tiny / "out").exists()
    solve.main(["00"])
    assert (tiny / "out" / "solutions" / "00_tiny.ipynb").exists()
