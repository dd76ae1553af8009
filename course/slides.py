"""Make slides of the notebooks: `make slides`, or `python -m course slides FOLDER`.

They follow from a notebook's structure; nothing is marked in it:

- A section (##) is a column of slides. A slide takes what fits of it, the next one below takes on; ### begins one, too.
- A cell that draws shows its picture and the caption. Other code is shown where it fits on one slide together with
  what it printed; longer code is left out, and only what it printed is shown.
- Left out are imports, the check of the installation, sliders, which need a kernel, and what prints more than a
  slide can hold.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides need no network.
"""

import ast
import math
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import nbformat
from markdown_it import MarkdownIt
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_markdown_cell, new_notebook

from course import nbtools

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js")
WIDTH, HEIGHT = 1100, 700  # pixels
FULL = 22.0  # lines of text on a slide
CHARACTERS = 90  # in such a line
PICTURE = 15.0  # lines
HIDDEN = "hide-input"
LINK = re.compile(r'<a href="(\d\d_\w+)\.ipynb[^"]*">(.*?)</a>')  # to another notebook


def make_slides(out: Path) -> None:
    """Write a page of slides for each notebook, and the scripts that show them, into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    shutil.copytree(REVEAL / "dist", out / "reveal.js/dist", ignore=shutil.ignore_patterns("*.map"), dirs_exist_ok=True)
    shutil.copy(REVEAL / "LICENSE", out / "reveal.js")
    shutil.copy(MATHJAX, out)
    exporter = SlidesExporter(
        extra_template_basedirs=[str(nbtools.ROOT / "book")],
        template_name="slides_template",
        reveal_url_prefix="reveal.js",
        reveal_theme="white",
        reveal_width=str(WIDTH),
        reveal_height=str(HEIGHT),
        mathjax_url=MATHJAX.name,
        exclude_anchor_links=True,
        config={"TagRemovePreprocessor": {"enabled": True, "remove_input_tags": [HIDDEN]}},
    )
    stems = [path.stem for path in nbtools.notebooks()]
    for path in nbtools.notebooks():
        nb = nbformat.read(path, as_version=4)
        page, _ = exporter.from_notebook_node(deal(nb), {"metadata": {"name": path.stem}})
        page = LINK.sub(
            lambda link: f'<a href="{link[1]}.slides.html">{link[2]}</a>' if link[1] in stems else link[2], page
        )
        (out / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")


def deal(nb: NotebookNode) -> NotebookNode:
    """Deal a notebook's pieces out to slides: a new notebook, whose cells say where a slide begins."""
    cells, filled = [], 0.0
    for cell in pieces(nb):
        lines = height(cell)
        place = {"#": "slide", "##": "slide", "###": "subslide"}.get(cell.source.partition(" ")[0], "-")
        if place == "-" and filled + lines > FULL:
            place = "subslide"
        filled = lines if place != "-" else filled + lines
        cell.metadata["slideshow"] = {"slide_type": place}
        cells.append(cell)
    return new_notebook(cells=cells, metadata=nb.metadata)


def pieces(nb: NotebookNode) -> Iterator[NotebookNode]:
    """Yield what the slides show of a notebook: blocks of text one by one, and cells of code."""
    for cell in nb.cells:
        if cell.cell_type == "markdown":
            lines = cell.source.splitlines()
            tokens = MarkdownIt().enable("table").parse(cell.source)
            blocks = [token.map for token in tokens if token.level == 0 and token.map]
            yield from (new_markdown_cell("\n".join(lines[first:last])) for first, last in blocks)
        elif cell.source != nbtools.SETUP and (cell.outputs or not (_imports(cell) or "interactive(" in cell.source)):
            if has_picture(cell) or height(cell) > FULL - 2:
                cell.metadata["tags"] = [*cell.metadata.get("tags", []), HIDDEN]
            if (cell.outputs or HIDDEN not in cell.metadata.get("tags", [])) and height(cell) <= FULL:
                yield cell


def height(cell: NotebookNode) -> float:
    """Return how many lines of text a piece takes on a slide, its margins included."""
    if cell.cell_type == "markdown":
        scale = 2.0 if cell.source.startswith(("#", "$$")) else 1.2 if cell.source.startswith("|") else 1.0
        return scale * _lines(cell.source) + 0.5
    shown = "" if HIDDEN in cell.metadata.get("tags", []) else cell.source
    said = [output.get("text") or output.get("data", {}).get("text/markdown", "") for output in cell.outputs]
    return PICTURE * has_picture(cell) + sum(0.9 * _lines(text) + 0.5 for text in [shown, *said] if text)


def has_picture(cell: NotebookNode) -> bool:
    """Say whether a cell shows a picture."""
    return any(set(nbtools.PICTURES) & set(output.get("data", {})) for output in cell.get("outputs", []))


def _lines(text: str) -> int:
    return sum(max(1, math.ceil(len(line) / CHARACTERS)) for line in text.splitlines())


def _imports(cell: NotebookNode) -> bool:
    return all(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.parse(cell.source).body)
