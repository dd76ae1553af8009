"""What the checkers have accepted lives on: a file for each notebook in `my_notebooks/mine`.

`keep` writes an accepted function there, with what it needs; `use` gives it to a later notebook,
or the solution where there is none. Once all that `one_file.depth` calls is there, `write_whole`
writes `omnistereo.py`, which computes depth from images without the library.

Nothing is kept unless the notebook runs in `my_notebooks`, or in `out/solutions`.
"""

from __future__ import annotations

import ast
import inspect
import re
import symtable
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import write_text

PLACES = ("my_notebooks", "solutions")  # the folders of notebooks whose functions are kept
WHOLE = "omnistereo.py"
OF_NOTEBOOK = '''"""Your functions of notebook {}, as its checkers accepted them."""
'''
OF_ALL = '''"""Depth from the images of a rig by your own functions; the checkers wrote it.

Run it: omnistereo depth --method {}
"""
'''
SLOW = "# {} times slower than the solution"


@dataclass
class Source:
    """Python source in pieces."""

    imports: dict[str, str] = field(default_factory=dict)  #: a line each, by the name that it binds
    pieces: dict[str, str] = field(
        default_factory=dict
    )  #: constants, functions and classes, by name

    @classmethod
    def of(cls, text: str) -> Source:
        """Take a source apart: of a kept file, or of a module that is written like one."""
        found, lines, end = cls(), text.splitlines(), 0
        for node in ast.parse(text).body:
            begin = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", ()))]) - 1
            above = [line for line in lines[end:begin] if line.startswith("#")]
            end = node.end_lineno or node.lineno
            piece = "\n".join([*above, *lines[begin:end]])
            if isinstance(node, ast.Import | ast.ImportFrom):
                found.imports[node.names[0].asname or node.names[0].name] = piece
            elif isinstance(node, ast.Assign):
                found.pieces[ast.unparse(node.targets[0])] = piece
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.pieces[node.name] = piece
        return found

    def text(self, head: str) -> str:
        """Return it as the text of a file."""
        imports = sorted(self.imports.values(), key=lambda line: (line.startswith("from"), line))
        first = "\n" + "\n".join(imports) + "\n" if imports else ""
        return head + first + "".join(f"\n\n{piece}\n" for piece in self.pieces.values())


def folder() -> Path | None:
    """Return the folder of what is kept, beside the notebook that runs; None if nothing is."""
    here = Path.cwd()
    return here / "mine" if here.name in PLACES else None


def number_of(answer: Callable[..., Any]) -> str:
    """Return the number of the notebook of a solution, such as "06"."""
    return answer.__module__.rpartition(".nb")[2]


def keep(function: Callable[..., Any], answer: Callable[..., Any], slow: int = 0) -> str:
    """Keep an accepted function; return in words where, or why not, or "" where nothing is kept.

    Args:
        function: The student's.
        answer: The solution.
        slow: How many times slower it is than the solution, if a notebook would wait for it.
    """
    if (mine := folder()) is None:
        return ""
    number, name = number_of(answer), answer.__name__
    path = mine / f"nb{number}.py"
    try:
        kept = Source.of(path.read_text(encoding="utf-8")) if path.is_file() else Source()
        add(kept, name, function, _namespace(function))
        if slow:
            kept.pieces[name] = f"{SLOW.format(slow)}\n{kept.pieces[name]}"
        text = kept.text(OF_NOTEBOOK.format(number))
        _run(text, path)
        mine.mkdir(exist_ok=True)
        write_text(path, text)
    except (Exception, SystemExit) as error:
        return f"not kept for later notebooks: {error}"
    return f"kept in mine/{path.name}"


def use(*names: str) -> list[Callable[..., Any]]:
    """Return functions of earlier notebooks, such as "03.look_up", and print which they are.

    The student's if it is kept and not slow, else the solution.
    """
    found, said = [], dict[str, list[str]]()
    for name in names:
        number, _, function = name.rpartition(".")
        own, slow = _kept(number).get(function, (None, False))
        solution = getattr(import_module(f"course.exercises.nb{number}"), function)
        which = "solution" if own is None else "solution, since yours is slow" if slow else "yours"
        said.setdefault(which, []).append(name)
        found.append(own if which == "yours" else solution)
    print("; ".join(f"{which}: {', '.join(of)}" for which, of in said.items()))
    return found


def _kept(number: str) -> dict[str, tuple[Callable[..., Any], bool]]:
    """Return the kept functions of a notebook, each with whether it is slow."""
    path = (folder() or Path()) / f"nb{number}.py"
    if folder() is None or not path.is_file():
        return {}
    try:
        text = path.read_text(encoding="utf-8")
        namespace = _run(text, path)
        pieces = Source.of(text).pieces
    except (Exception, SystemExit) as error:
        print(
            f"mine/{path.name} stops with {type(error).__name__}: {error}. Run its notebook again"
        )
        return {}
    slow = re.compile(SLOW.format(r"\d+"))
    return {name: (namespace[name], bool(slow.match(piece))) for name, piece in pieces.items()}


def _run(text: str, path: Path) -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": path.stem}
    exec(compile(text, str(path), "exec"), namespace)
    return namespace


# --- The source of a function, with what it needs


def _namespace(function: Callable[..., Any]) -> dict[str, Any]:
    inner = inspect.unwrap(function)
    if not isinstance(inner, FunctionType):
        raise OmnistereoError(f"it is a {type(function).__name__}; write it as a function")
    return inner.__globals__


def add(
    kept: Source, name: str, value: Any, namespace: dict[str, Any], inline: bool = False
) -> None:
    """Add to a source what a name of a notebook means, and what that needs in turn.

    Args:
        namespace: That of the notebook.
        inline: The course's functions are written out, too, not imported.
    """
    module, origin = getattr(value, "__module__", None), getattr(value, "__name__", None)
    if _is_own(value, namespace):
        source = textwrap.dedent(inspect.getsource(inspect.unwrap(value))).rstrip()
        defined = next(iter(Source.of(source).pieces))
        for needed in global_names(source):
            if needed in namespace and needed not in (name, defined):
                add(kept, needed, namespace[needed], namespace, inline)
        for bound in (name, defined):
            kept.imports.pop(bound, None)
            kept.pieces.pop(bound, None)
        kept.pieces[defined] = source
        if defined != name:
            kept.pieces[name] = f"{name} = {defined}"
    elif inline and isinstance(value, FunctionType) and str(module).startswith("course."):
        add(kept, name, value, value.__globals__, inline)
    elif isinstance(value, ModuleType):
        kept.imports[name] = f"import {origin}" + (f" as {name}" if name != origin else "")
    elif origin and getattr(sys.modules.get(str(module)), origin, None) is value:
        if name not in kept.pieces:  # accepted since: a solution that it was checked with
            kept.imports[name] = f"from {module} import {origin}" + f" as {name}" * (name != origin)
    elif (constant := _constant(value)) is not None:
        kept.pieces[name] = f"{name} = {constant}"
        if isinstance(value, np.ndarray):
            kept.imports.setdefault("np", "import numpy as np")
    else:
        kind = type(value).__name__
        raise OmnistereoError(f"it uses `{name}`, a {kind} of the notebook. Compute it inside")


def _is_own(value: Any, namespace: dict[str, Any]) -> bool:
    """Whether a function or class is written in the notebook."""
    inner = inspect.unwrap(value) if callable(value) else value
    if isinstance(inner, type):
        return inner.__module__ == namespace.get("__name__")
    return isinstance(inner, FunctionType) and inner.__globals__ is namespace


def _constant(value: Any) -> str | None:
    """Return how a number, a text, or a few of them are written; None if that is not possible."""
    if isinstance(value, np.ndarray):
        known = value.size <= 64 and value.dtype.kind in "iuf" and np.isfinite(value).all()
        return f"np.array({value.tolist()}, dtype=np.{value.dtype})" if known else None
    text = repr(value.item() if isinstance(value, np.generic) else value)
    try:
        return text if len(text) <= 1000 and bool(ast.literal_eval(text) == value) else None
    except (ValueError, SyntaxError):
        return None


def global_names(source: str) -> list[str]:
    """Return the names that a source looks up outside of its functions."""

    def tables(table: symtable.SymbolTable) -> Iterator[symtable.SymbolTable]:
        yield table
        for child in table.get_children():
            yield from tables(child)

    whole = symtable.symtable(source, "source", "exec")
    return sorted(
        symbol.get_name()
        for table in tables(whole)
        for symbol in table.get_symbols()
        if symbol.is_referenced() and (symbol.is_global() or table is whole)
    )


# --- All in one file


def _one_file() -> Any:
    """Return the module whose functions call those of the notebooks, which this module serves."""
    return import_module("course.exercises.one_file")


def needed() -> dict[str, Callable[..., Any]]:
    """Return the solutions of all functions that `one_file` calls, by name, in their order."""
    one_file = _one_file()
    found, left = dict[str, FunctionType](), [one_file.depth]
    for function in left:  # grows
        names = global_names(inspect.getsource(function))
        called = [f for f in map(function.__globals__.get, names) if isinstance(f, FunctionType)]
        left += [f for f in called if f not in left]
        found |= {f.__name__: f for f in called if ".exercises.nb" in f.__module__}
    return dict(sorted(found.items(), key=lambda item: (number_of(item[1]), item[0])))


def write_whole() -> str:
    """Write `omnistereo.py` if all that it needs is kept; return in words what came of it."""
    one_file = _one_file()
    if (mine := folder()) is None:
        return ""
    solutions = needed()
    kept = {number: _kept(number) for number in {*map(number_of, solutions.values())}}
    if not all(name in kept[number_of(answer)] for name, answer in solutions.items()):
        return ""
    whole, slow = Source.of(inspect.getsource(one_file)), []
    whole.imports = {name: line for name, line in whole.imports.items() if "course" not in line}
    frame, whole.pieces = whole.pieces, {}
    for number in sorted(kept):
        of_notebook, of_others = Source(), {*frame}
        for name, answer in solutions.items():
            if number_of(answer) != number:
                of_others.add(name)
                continue
            own, is_slow = kept[number][name]
            slow += [name] * is_slow
            function = answer if is_slow else own
            add(of_notebook, name, function, _namespace(function), inline=True)
        _join(whole, of_notebook, number, of_others)
    whole.pieces |= frame
    write_text(mine / WHOLE, whole.text(OF_ALL.format(f"{mine.parent.name}/mine/{WHOLE}")))
    others = f"; of {', '.join(slow)} the solution, since yours is slow" if slow else ""
    return f"mine/{WHOLE}: depth from images by {len(solutions)} functions of yours{others}"


def _join(whole: Source, part: Source, number: str, taken: set[str]) -> None:
    """Add the source of a notebook; a name that another notebook uses otherwise is changed."""
    before = whole.imports | whole.pieces
    for name, text in (part.imports | part.pieces).items():
        if name in taken or before.get(name, text) != text:
            part = _renamed(part, name, f"{name}_{number}")
    whole.imports |= part.imports
    whole.pieces |= part.pieces


def _renamed(source: Source, old: str, new: str) -> Source:
    """Return a source with one of its names changed wherever it is used."""
    imports = {}
    for name, line in source.imports.items():
        tree = ast.parse(line)
        if name == old:
            tree.body[0].names[0].asname = new  # type: ignore[attr-defined]
        imports[new if name == old else name] = ast.unparse(tree)
    pieces = {}
    for name, piece in source.pieces.items():
        lines = [line.encode() for line in piece.splitlines()]
        nodes = [
            node
            for node in ast.walk(ast.parse(piece))
            if isinstance(node, ast.Name) and node.id == old
        ]
        for node in sorted(nodes, key=lambda node: -node.col_offset):
            row, column = node.lineno - 1, node.col_offset
            lines[row] = (
                lines[row][:column] + new.encode() + lines[row][column + len(old.encode()) :]
            )
        text = b"\n".join(lines).decode()
        text = re.sub(rf"^(def|class) {old}\b", rf"\1 {new}", text, flags=re.MULTILINE)
        pieces[new if name == old else name] = text
    return Source(imports, pieces)
