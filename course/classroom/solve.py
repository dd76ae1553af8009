"""Write the notebooks with their open functions solved, and run them: `python -m course solve`
fills out/solutions.

A solution notebook is the stored notebook with every stub, a function that ends in `...`, replaced
by the right answer in course/exercises.
"""

import ast
import copy
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from nbformat import NotebookNode

from course import exercises, kernels, nbtools
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import write_text

OUT = nbtools.ROOT / "out" / "solutions"
LOOKED_UP = ("data_samples", "omnistereo_lib")  # by the notebooks, in `../`


def stubs(source: str) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a cell that are still to be written: they end in `...`."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and ast.unparse(node.body[-1]).endswith("..."):
            yield node


def solved(source: str, answers: dict[str, Callable[..., Any]]) -> str:
    """Return a cell's source with the answers in the place of its stubs."""
    lines = source.splitlines()
    # from below, so that the line numbers above stay right
    for stub in reversed(list(stubs(source))):
        if stub.name not in answers:
            known = ", ".join(answers)
            raise OmnistereoError(
                f"the stub {stub.name} has no answer in course/exercises; there are {known}"
            )
        lines[stub.lineno - 1 : stub.end_lineno] = (
            inspect.getsource(answers[stub.name]).rstrip().splitlines()
        )
    return "\n".join(lines)


def solve(nb: NotebookNode, answers: dict[str, Callable[..., Any]]) -> NotebookNode:
    """Return a notebook with its stubs solved, and those cells not run."""
    nb = copy.deepcopy(nb)
    for cell in nbtools.code_cells(nb):
        source = solved(cell.source, answers)
        if source != cell.source:
            cell.source, cell.outputs, cell.execution_count = source, [], None
    return nb


def open_answers(number: str) -> dict[str, Callable[..., Any]]:
    """Return the right answers of the functions that a notebook leaves open, by name."""
    return {function.name: function.answer for function in exercises.functions(number)}


def not_right(nb: NotebookNode) -> list[str]:
    """Return what the checkers said of a solved notebook's functions, where it is not "right"."""
    checks = re.compile(r"\bnb\w+\.check_\w+\(")
    cells = [cell for cell in nbtools.code_cells(nb) if checks.search(cell.source)]
    said = ["".join(output.get("text", "") for output in cell.outputs).strip() for cell in cells]
    right = re.compile(r"^.*\w+: right, .+ with yours\.$", re.MULTILINE)
    return [words for words in said if not right.search(words)]


def main(names: list[str]) -> None:
    """Run and store the solution notebooks; link what they look for in `../` beside their folder.

    Args:
        names: Numbers of the notebooks, such as "04"; all of them if empty.

    Raises:
        OmnistereoError: If there is no such notebook, one stops, or a checker does not call a
            solution right.
    """
    known = [nbtools.number(path) for path in nbtools.notebooks()]
    if unknown := [name for name in names if name not in known]:
        raise OmnistereoError(
            f"there is no notebook {', '.join(unknown)}; expected one of {', '.join(known)}"
        )
    OUT.mkdir(parents=True, exist_ok=True)
    for name in LOOKED_UP:
        if not (OUT.parent / name).exists():
            (OUT.parent / name).symlink_to(Path("..") / name)
    for path in nbtools.notebooks():
        if names and nbtools.number(path) not in names:
            continue
        nb = solve(nbtools.read_notebook(path), open_answers(nbtools.number(path)))
        try:
            seconds = kernels.execute(nb, OUT)
        except CellExecutionError as error:
            raise OmnistereoError(
                f"{path.name} with its solutions stopped: {error.ename}: {error.evalue}"
            ) from None
        except (CellTimeoutError, DeadKernelError) as error:
            raise OmnistereoError(f"{path.name} with its solutions stopped: {error}") from None
        if wrong := not_right(nb):
            raise OmnistereoError(f"{path.name}: of a solution the checker says: {wrong[0]}")
        write_text(OUT / path.name, nbtools.text_of(nbtools.clean(nb)))
        print(f"{path.name}: all right, {seconds:.0f} s", flush=True)
    print(f"The notebooks with solutions: {OUT.relative_to(nbtools.ROOT)}")
