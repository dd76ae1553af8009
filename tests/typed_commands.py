"""The commands that stand on the pages of the project, as a reader would copy them."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import nbformat

from course import __main__ as course
from omnistereo_tools import cli
from workshop import __main__ as workshop
from workshop import render

ROOT = Path(__file__).resolve().parents[1]
PAGES = ["README.md", "CONTRIBUTING.md"]
PAGES += sorted(f"book/{path.name}" for path in ROOT.glob("book/*.md"))
HELP = [
    *(f"omnistereo {name}" for name in cli.COMMANDS),
    "python -m course",
    "python -m workshop",
    "python -m workshop.render",
]
NOTEBOOKS = sorted(f"notebooks/{path.name}" for path in ROOT.glob("notebooks/*.ipynb"))

# A fence, a remark that the next block is not run, or code within a line.
_FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_MARK = re.compile(
    r"<!-- not run: (?P<reason>.*?)(?:; instead: (?P<instead>.*?))? -->\n", re.DOTALL
)
_INLINE = re.compile(
    r"(?<!`)`(?P<text>(?:omnistereo|make|python -m|\.venv\S*/python -m) [^`\n]+)`(?!`)"
)


@dataclass(frozen=True)
class Typed:
    """One command or block of Python, and where it stands."""

    page: str
    text: str
    language: str = "sh"
    reason: str | None = None  #: why it is not run here
    instead: str | None = None  #: what is run in its place

    def __str__(self) -> str:
        return f"{self.page}: {' '.join(self.text.split())[:90]}"


def commands_of(page: str) -> list[Typed]:
    """Return the commands of a page or of a command's help, in their order."""
    if page in HELP:
        examples = re.findall(r"^  ((?:omnistereo|python -m) .*)$", help_of(page), re.MULTILINE)
        needs = ("needs the environment of Blender", f"{page} --help")
        blender = needs if "render" in page else (None, None)
        return [Typed(f"{page} --help", example, "sh", *blender) for example in examples]
    text = (
        "\n\n".join(_markdown(ROOT / page))
        if page.endswith(".ipynb")
        else (ROOT / page).read_text(encoding="utf-8")
    )
    return _commands_in(page, text)


@cache
def help_of(command: str) -> str:
    """Return what `--help` prints."""
    program, *words = command.removeprefix("python -m ").split()
    run = {
        "omnistereo": cli.main,
        "course": course.main,
        "workshop": workshop.main,
        "workshop.render": render.main,
    }[program]
    with redirect_stdout(io.StringIO()) as said, suppress(SystemExit):
        run([*words, "--help"])
    return said.getvalue()


def _markdown(path: Path) -> list[str]:
    """Return the text cells of a notebook without folded solutions, which are tested as answers."""
    cells = nbformat.read(path, as_version=4).cells
    return [
        re.sub(r"<details>.*?</details>", "", c.source, flags=re.DOTALL)
        for c in cells
        if c.cell_type == "markdown"
    ]


def _commands_in(page: str, text: str) -> list[Typed]:
    """Split a text at its fences; a mark holds for what follows it."""
    found, at = [], 0
    for fence in [*_FENCE.finditer(text), None]:
        before = text[at : fence.start() if fence else len(text)]
        paragraphs = re.split(r"\n\s*\n", before)
        for paragraph in paragraphs:
            mark = _MARK.search(paragraph)
            found += [
                _typed(page, m["text"], "inline", mark)
                for m in _INLINE.finditer(_MARK.sub("", paragraph))
            ]
        if fence is None:
            break
        mark = _MARK.search(paragraphs[-1]) if paragraphs[-1].rstrip().endswith("-->") else None
        if fence[1] in ("sh", "bash"):
            found += [_typed(page, line, "sh", mark) for line in _lines(fence[2])]
        elif fence[1] == "python":
            found.append(_typed(page, fence[2], "python", mark))
        at = fence.end()
    return found


def _typed(page: str, text: str, language: str, mark: re.Match | None) -> Typed:
    return Typed(page, text, language, mark and mark["reason"], mark and mark["instead"])


def _lines(block: str) -> list[str]:
    """Return the commands of a block; continued lines and here-documents are one."""
    commands, rest = [], iter(block.splitlines())
    for line in rest:
        while line.endswith("\\"):
            line += "\n" + next(rest)
        if end := re.search(r"<<'?(\w+)", line):
            while line.rsplit("\n", 1)[-1] != end[1]:
                line += "\n" + next(rest)
        command = re.sub(r"\s+#.*$", "", line) if "\n" not in line else line
        if command.strip() and not command.startswith("#"):
            commands.append(command)
    return commands
