"""Make slides of the notebooks: `make slides`, or `python -m course slides FOLDER`.

nbconvert writes each notebook as one page, and deal.js, beside it, deals the page out to slides in the browser: it
begins a slide at each heading, and where the next piece does not fit. Nothing has to be marked in a notebook; `shown`
says what the slides leave out. A cell with the tag `skip` is left out, too.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides need no network.
"""

import ast
import html
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import nbformat
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_notebook, new_output

from course import nbtools, solve, stills

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js")
BOOK = nbtools.ROOT / "book"
TEMPLATE = BOOK / "slides_template"
SCRIPTS = (MATHJAX, BOOK / "stills.js", TEMPLATE / "deal.js")
LINK = re.compile(r'<a href="(\d\db?_\w+)\.ipynb[^"]*">(.*?)</a>')  # to another notebook


def make_slides(out: Path) -> None:
    """Write a page of slides for each notebook, the page that leads to them, and the scripts that show them."""
    (out / "reveal.js").mkdir(parents=True, exist_ok=True)
    shutil.copytree(REVEAL / "dist", out / "reveal.js/dist", ignore=shutil.ignore_patterns("*.map"), dirs_exist_ok=True)
    shutil.copy(REVEAL / "LICENSE", out / "reveal.js")
    for script in SCRIPTS:
        shutil.copy(script, out)
    exporter = SlidesExporter(
        extra_template_basedirs=[str(BOOK)],
        template_name=TEMPLATE.name,
        reveal_url_prefix="reveal.js",
        reveal_theme="white",
        exclude_anchor_links=True,
        config={"TagRemovePreprocessor": {"enabled": True, "remove_input_tags": ["hide-input"]}},
    )
    entries, stems = [], [path.stem for path in nbtools.notebooks()]
    for path in nbtools.notebooks():
        nb = nbformat.read(path, as_version=4)
        cells = list(shown(nb, path.stem, out))
        page, _ = exporter.from_notebook_node(new_notebook(cells=cells, metadata=nb.metadata | {"title": path.stem}))
        page = LINK.sub(
            lambda link: f'<a href="{link[1]}.slides.html">{link[2]}</a>' if link[1] in stems else link[2], page
        )
        (out / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")
        facts = nb.metadata["omnistereo"]
        title, learn = html.escape(f"{nbtools.number(path)} {facts['title']}"), html.escape(facts["learn"])
        entries.append(f'<li><a href="{path.stem}.slides.html">{title}</a>: {learn}</li>')
    index = (TEMPLATE / "list.html").read_text(encoding="utf-8")
    (out / "index.html").write_text(index.replace("{entries}", "\n".join(entries)), encoding="utf-8")
    print(f"Written: {out / 'index.html'}. Open it in a browser; it needs no network.")


def shown(nb: NotebookNode, stem: str, out: Path) -> Iterator[NotebookNode]:
    """Yield the cells that the slides show of a notebook.

    Not imports, nor the check of the installation; of a figure the picture without its code; of a live figure its
    stills; of an exercise the solution; a solution comes at the next step.
    """
    live = 0
    for cell in nb.cells:
        tags = cell.metadata.setdefault("tags", [])
        if cell.cell_type == "code":
            for _ in stills.LIVE.findall(cell.source):
                figure = stills.shown(stem, live, out).replace(
                    '<iframe class="view" src', '<iframe class="view" data-src'
                )
                cell.outputs.append(new_output("display_data", {"text/html": figure}))
                live += 1
            if any(stub.name in solve.ANSWERS for stub in solve.stubs(cell.source)):  # an exercise; others are folded
                tags.append("solution")
                cell.source, cell.outputs = solve.solved(cell.source, solve.ANSWERS), []
            elif {*nbtools.PICTURES, "text/html"} & {
                mime for output in cell.outputs for mime in output.get("data", {})
            }:
                tags.append("hide-input")
            elif cell.source == nbtools.SETUP or (not cell.outputs and only_imports(cell.source)):
                continue
        if "skip" not in tags:
            yield cell


def only_imports(source: str) -> bool:
    """Tell whether a cell only imports."""
    return all(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.parse(source).body)
