"""Every exercise has one solution, which its checker calls right, and the solution notebooks add nothing else."""

import ast
import inspect

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from course import nbtools, solve
from omnistereo_lib.errors import OmnistereoError

STORED = {path: nbformat.read(path, as_version=4) for path in nbtools.notebooks()}
EXERCISES = [
    pytest.param(path, cell, id=f"{path.stem[:2]} {next(solve.stubs(cell.source)).name}")
    for path, nb in STORED.items()
    for cell in nbtools.code_cells(nb)
    if any(solve.stubs(cell.source))
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
        assert handed == [stub.name for stub in solve.stubs(cell.source)]


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


def test_solution_without_a_stub_is_named(course):
    with pytest.raises(OmnistereoError, match="solves half, of which no notebook has a stub; there are double"):
        solve.solve_all([course], {"double": double, "half": half})


def test_command_writes_notebooks_that_find_the_data(course, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(solve.nbtools, "ROOT", tmp_path)
    monkeypatch.setattr(solve.nbtools, "notebooks", lambda: [course])
    monkeypatch.setattr(solve, "OUT", tmp_path / "out" / "solutions")
    monkeypatch.setattr(solve, "ANSWERS", {"double": double})
    (tmp_path / "data_samples").mkdir()
    solve.main()
    solve.main()  # a second time over the first
    assert capsys.readouterr().out == 2 * "The notebooks with solutions: out/solutions\n"
    nbformat.validate(nbformat.read(tmp_path / "out" / "solutions" / course.name, as_version=4))
    assert (tmp_path / "out" / "solutions" / ".." / "data_samples").resolve() == tmp_path / "data_samples"


def test_command_says_plainly_what_is_missing(course, monkeypatch):
    monkeypatch.setattr(solve.nbtools, "notebooks", lambda: [course])
    monkeypatch.setattr(solve, "ANSWERS", {})
    with pytest.raises(SystemExit, match="the stub double has no solution"):
        solve.main()
