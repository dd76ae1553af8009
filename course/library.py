"""The library's public names and their docstrings, read from the source files without running them."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "omnistereo_lib"


@cache
def modules() -> dict[str, Path]:
    """Return every module's full name and its file, in alphabetical order."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = path
    return found


def module_of(name: str) -> str:
    """Return the full name of the module that holds a full name."""
    while name not in modules():
        name = name.rpartition(".")[0]
    return name


@cache
def docstrings() -> dict[str, str]:
    """Return the docstrings of all modules and of their public classes and functions, by full name."""
    return {
        name: docstring
        for module, path in modules().items()
        for name, docstring in _docstrings(ast.parse(path.read_text(encoding="utf-8")), module)
    }


def _docstrings(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> Iterator[tuple[str, str]]:
    if docstring := ast.get_docstring(node):
        yield name, docstring
    for child in node.body:
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and not child.name.startswith("_"):
            yield from _docstrings(child, f"{name}.{child.name}")


def summary(docstring: str) -> str:
    """Return the first sentence or two of a docstring, for a cell of a Markdown table."""
    text = " ".join(docstring.partition("\n\n")[0].split())
    return re.sub(r"`[^`]*`|\*", lambda found: found[0] if len(found[0]) > 1 else r"\*", text).replace("|", r"\|")
