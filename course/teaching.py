"""The part of the teacher's page that is generated: the mistakes that the checkers recognise, by notebook."""

import html
import re
from collections.abc import Iterator

import nbformat

from course import handin, nbtools


def stuck() -> dict[str, str]:
    """Return, for each notebook, the part of book/teaching.md that `<!-- stuck 04 -->` stands for, in Markdown."""
    parts = {}
    for path in nbtools.notebooks():
        asked = handin.exercises_of(nbformat.read(path, as_version=4))
        lines = ["\n  - ".join([f"- **{exercise.number}**", *hints(exercise)]) for exercise in asked]
        head = "<details><summary>All mistakes that the checkers know by name</summary>"
        parts[f"stuck {path.stem[:2]}"] = "\n".join([head, "", *lines, "", "</details>"])
    return parts


def hints(exercise: handin.Exercise) -> Iterator[str]:
    """Yield what an exercise's checker says of each mistake that it knows, once."""
    said = (hint for _, hint in next(exercise.cases())[2])
    yield from (re.sub(r"([*_`])", r"\\\1", html.escape(hint, quote=False)) for hint in dict.fromkeys(said))
