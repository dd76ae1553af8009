"""The stored lists and pictures of the README and the book's pages: `python -m workshop pages`.

A list is made from the notebooks, the checkers or the library, and lies on its page between two
comments such as `<!-- written -->` and `<!-- /written -->`, so that a page reads on a code host as
it does in the website.
"""

import ast
import html
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

import nbformat

import omnistereo_learn
import omnistereo_lib as osl
import omnistereo_rigs
from course import exercises, nbtools
from course.classroom import handin
from omnistereo_lib.files import write_text
from workshop.results import error_bars, ray_sentences

BOOK = nbtools.ROOT / "book"
README = nbtools.ROOT / "README.md"
FACES = {"osl.": osl, "omnistereo_rigs.": omnistereo_rigs, "omnistereo_learn.": omnistereo_learn}
LIST = re.compile(r"(?<=<!-- )(\w+)( -->\n).*?(?=<!-- /\1 -->)", re.DOTALL)


def main() -> None:
    """Update all lists, and the pictures that show something else by now."""
    from workshop.publish.notation import draw_figures
    from workshop.publish.readme import renew, update_pictures

    for page in (README, *sorted(BOOK.glob("*.md"))):
        write_text(page, with_lists(page.read_text(encoding="utf-8")))
    for name, picture in draw_figures().items():
        renew(BOOK / name, picture)
    update_pictures()


def with_lists(page: str) -> str:
    """Return the text of a page with its lists renewed."""
    return LIST.sub(lambda found: f"{found[1]}{found[2]}{LISTS[found[1]]()}", page)


def notebooks() -> str:
    """Return the table of the notebooks, from their own metadata."""
    rows = ["| notebook | what you learn | you write | to read | needs |", "|---|---|---|---|---|"]
    for path in nbtools.notebooks():
        nb = nbtools.read_notebook(path)
        facts, count = nb.metadata["omnistereo"], len(nbtools.open_functions(nb))
        rows.append(
            f"| [{nbtools.number(path)} {facts['title']}](notebooks/{path.name}) | {facts['learn']}"
            f" | {count} functions | {facts['minutes_to_read']} min | {facts['needs']} |"
        )
    return "\n".join(rows) + "\n"


def mistakes() -> str:
    """Return what the checkers say of the mistakes that they know, by notebook and function."""
    lines = []
    for path in nbtools.notebooks():
        nb = nbformat.read(path, as_version=4)
        lines.append(f"\n## {nbtools.number(path)} {nb.metadata['omnistereo']['title']}\n")
        for exercise in handin.exercises_of(nb):
            lines += [f"- **{exercise.number}**", *(f"  - {hint}" for hint in hints(exercise))]
    return "\n".join(lines) + "\n\n"


def hints(exercise: handin.Exercise) -> Iterator[str]:
    """Yield what an exercise's checker says of each mistake that it knows, once."""
    said = (hint for _, hint in exercise.open.slips)
    yield from (
        re.sub(r"([*_`])", r"\\\1", html.escape(hint, quote=False)) for hint in dict.fromkeys(said)
    )


def written() -> str:
    """Return the table of all functions that students write, with its total."""
    rows, total = ["| notebook | you write | which returns | lines |", "|---|---|---|---:|"], 0
    for path in nbtools.notebooks():
        for function in exercises.functions(nbtools.number(path)):
            tree: Any = ast.parse(function.source)
            body = tree.body[0].body[1:]  # without the docstring
            lines = function.source.splitlines()[body[0].lineno - 1 :]
            total += len(lines)
            number = f"[{nbtools.number(path)}](../notebooks/{path.name})"
            returns = summary(function.answer)
            rows.append(f"| {number} | `{function.name}` | {returns} | {len(lines)} |")
    return "\n".join([*rows, f"| | | **all together** | **{total}** |"]) + "\n"


def names() -> str:
    """Return the table of the names that the packages offer."""
    rows = [
        f"| `{prefix}{name}` | {_what(getattr(package, name))} |\n"
        for prefix, package in FACES.items()
        for name in package.__all__
    ]
    return "| name | what it is |\n|---|---|\n" + "".join(rows)


def modules() -> str:
    """Return the table of the library's stages."""
    rows = []
    for stage, names in stages().items():
        path = stage.replace(".", "/") + ("" if len(names) > 1 else ".py")
        rows.append(f"| [`{stage}`](../{path}) | {summary(import_module(names[0]))} |\n")
    return "| module | what it is |\n|---|---|\n" + "".join(rows)


def stages() -> dict[str, list[str]]:
    """Return the names of modules by stage: the package, and the next part of the name."""
    found: dict[str, list[str]] = {}
    for package in FACES.values():
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            found.setdefault(".".join(module.name.split(".")[:2]), []).append(module.name)
    return found


def _what(thing: object) -> str:
    """Return the summary of a name; of a table of recipes, what it holds."""
    return f"Settings by name: {', '.join(thing)}." if isinstance(thing, dict) else summary(thing)


def summary(thing: object) -> str:
    """Return the first paragraph of a docstring, for a cell of a Markdown table."""
    text = " ".join(inspect.getdoc(thing).partition("\n\n")[0].split())
    return text.replace("|", r"\|").replace("*", r"\*")


LISTS: dict[str, Callable[[], str]] = {
    "notebooks": notebooks,
    "mistakes": mistakes,
    "written": written,
    "names": names,
    "modules": modules,
    "error_bars": error_bars.table,
    "ray_sentences": ray_sentences.table,
}
