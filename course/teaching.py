"""Generated parts of the book: the mistakes that the checkers recognise, and what students write, by notebook."""

import ast
import html
import inspect
import re
from collections.abc import Iterator

import nbformat

from course import exercises, handin, nbtools


def stuck() -> dict[str, str]:
    """Return, for each notebook, the part of book/teaching.md that `<!-- stuck 04 -->` stands for, in Markdown."""
    parts = {}
    for path in nbtools.notebooks():
        asked = handin.exercises_of(nbformat.read(path, as_version=4))
        lines = ["\n  - ".join([f"- **{exercise.number}**", *hints(exercise)]) for exercise in asked]
        head = "<details><summary>All mistakes that the checkers know by name</summary>"
        parts[f"stuck {nbtools.number(path)}"] = "\n".join([head, "", *lines, "", "</details>"])
    return parts


def written() -> str:
    """Return the table of all functions that students write, in Markdown, with its total."""
    rows, total = ["| notebook | you write | which returns | lines |", "|---|---|---|---:|"], 0
    for path in nbtools.notebooks():
        for function in exercises.functions(nbtools.number(path)):
            body = ast.parse(function.source).body[0].body[1:]  # without the docstring
            lines = function.source.splitlines()[body[0].lineno - 1 :]
            total += len(lines)
            number = f"[{nbtools.number(path)}](notebooks/{path.name})"
            returns = inspect.getdoc(function.answer).splitlines()[0]
            rows.append(f"| {number} | `{function.name}` | {returns} | {len(lines)} |")
    return "\n".join([*rows, f"| | | **all together** | **{total}** |"])


def hints(exercise: handin.Exercise) -> Iterator[str]:
    """Yield what an exercise's checker says of each mistake that it knows, once."""
    said = (hint for _, hint in next(exercise.cases())[2])
    yield from (re.sub(r"([*_`])", r"\\\1", html.escape(hint, quote=False)) for hint in dict.fromkeys(said))
