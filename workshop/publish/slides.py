"""Make slides of the notebooks: `make slides`, or `python -m workshop slides FOLDER`.

nbconvert writes each notebook as one page, and deal.js, beside it, deals the page out to slides in
the browser: it begins a slide at each heading, and where the next piece does not fit. What
book/slides/NUMBER.yaml says is shown: on each slide an idea, one figure, formula or function of
the notebook, and a sentence.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides
need no network.
"""

import copy
import html
import io
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import nbformat
import yaml
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_markdown_cell, new_notebook
from PIL import Image

from course import nbtools
from course.classroom import solve
from omnistereo_lib.errors import OmnistereoError

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(
    find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js"
)
BOOK = nbtools.ROOT / "book"
TEMPLATE = BOOK / "slides_template"
WRITTEN = BOOK / "slides"
SCRIPTS = (MATHJAX, TEMPLATE / "deal.js")
DOCSTRING = re.compile(r'^ +""".*?"""\n', re.DOTALL | re.MULTILINE)
SHOWN = re.compile(r'\bshow\(.*, "([^"]+)"\)')  # the name of a figure


def make_slides(out: Path, notebook: str | None = None, pdf: bool = False) -> None:
    """Write a page of slides for each notebook, the page that leads to them, and the scripts that
    show them.

    Args:
        out: The folder.
        notebook: The number of the only one that is wanted, such as "03".
        pdf: Print each to a PDF as well, by the Chromium that Playwright drives.
    """
    paths = [path for path in nbtools.notebooks() if notebook in (None, nbtools.number(path))]
    if not paths:
        numbers = ", ".join(map(nbtools.number, nbtools.notebooks()))
        raise OmnistereoError(f"there is no notebook {notebook!r}; expected one of {numbers}")
    (out / "reveal.js").mkdir(parents=True, exist_ok=True)
    shutil.copytree(
        REVEAL / "dist",
        out / "reveal.js/dist",
        ignore=shutil.ignore_patterns("*.map"),
        dirs_exist_ok=True,
    )
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
    entries = []
    for path in paths:
        nb = nbformat.read(path, as_version=4)
        cells = list(shown(nb, nbtools.number(path)))
        page, _ = exporter.from_notebook_node(
            new_notebook(cells=cells, metadata=nb.metadata | {"title": path.stem})
        )
        (out / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")
        facts = nb.metadata["omnistereo"]
        title, learn = (
            html.escape(f"{nbtools.number(path)} {facts['title']}"),
            html.escape(facts["learn"]),
        )
        entries.append(f'<li><a href="{path.stem}.slides.html">{title}</a>: {learn}</li>')
    index = (TEMPLATE / "list.html").read_text(encoding="utf-8")
    (out / "index.html").write_text(
        index.replace("{entries}", "\n".join(entries)), encoding="utf-8"
    )
    print(f"Written: {out / 'index.html'}. Open it in a browser; it needs no network.")
    if pdf:
        print_slides([out / f"{path.stem}.slides.html" for path in paths])


def print_slides(pages: list[Path]) -> None:
    """Write pages of slides to PDF files beside them, a picture of each slide with all its steps.

    Printed by reveal.js itself, pictures would not shrink to the room that the text leaves.
    """
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"))
        except Error as error:
            raise OmnistereoError(
                f"no browser for the PDF ({error.message.splitlines()[0]}). "
                "Install one: .venv/bin/playwright install chromium"
            ) from None
        tab = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=1.5)
        for page in pages:
            tab.goto(page.resolve().as_uri())
            tab.wait_for_function("window.Reveal && Reveal.isReady()", timeout=120_000)
            shots = []
            for place in tab.evaluate("Reveal.getSlides().map(s => Reveal.getIndices(s))"):
                tab.evaluate("([h, v]) => Reveal.slide(h, v, 99)", [place["h"], place.get("v", 0)])
                shots.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
            pdf = page.with_name(page.name.replace(".slides.html", ".pdf"))
            shots[0].save(pdf, save_all=True, append_images=shots[1:], resolution=144)
            print(f"Written: {pdf}, {len(shots)} slides")
        browser.close()


def shown(nb: NotebookNode, number: str) -> Iterator[NotebookNode]:
    """Yield the cells of a notebook's slides: an idea, a sentence, what there is to see."""
    script = WRITTEN / f"{number}.yaml"
    first = nb.cells[0].source.partition("\n")[0]
    learn = nb.metadata["omnistereo"]["learn"]
    yield new_markdown_cell(f"{first}\n\nYou will {learn}.\n\n{first_picture(nb)}")
    solutions = folded_solutions(nb)
    for slide in yaml.safe_load(script.read_text(encoding="utf-8")):
        formula = f"\n\n$$ {slide['formula']} $$" if "formula" in slide else ""
        idea = html.escape(slide["idea"])
        yield new_markdown_cell(f"<h2 class='slide'>{idea}</h2>\n\n{slide['say']}{formula}")
        for cell in nbtools.code_cells(nb):
            cell.metadata.setdefault("tags", [])
            if slide.get("function") in {stub.name for stub in solve.stubs(cell.source)}:
                yield cell
                yield new_markdown_cell(solutions[slide["function"]])
            names = SHOWN.findall(cell.source)
            if slide.get("figure") in names:
                pictures = [o for o in cell.outputs if {*nbtools.PICTURES} & {*o.get("data", {})}]
                only = copy.deepcopy(cell)
                only.outputs = [pictures[names.index(slide["figure"])]]
                only.metadata.tags = ["hide-input"]
                yield only


def folded_solutions(nb: NotebookNode) -> dict[str, str]:
    """Return the folds with the solutions of a notebook, without the docstrings its stubs have."""
    text = "\n".join(cell.source for cell in nb.cells)
    folds = {
        fold[2]: DOCSTRING.sub("", fold[0], count=1) for fold in nbtools.SOLUTION.finditer(text)
    }
    return {name: f"{fold}\n```\n</details>" for name, fold in folds.items()}


def first_picture(nb: NotebookNode) -> str:
    """Return the first picture of a notebook as HTML."""
    outputs = (output for cell in nbtools.code_cells(nb) for output in cell.outputs)
    for data in (output.get("data", {}) for output in outputs):
        for mime in {*nbtools.PICTURES} & {*data}:
            alt, content = html.escape(data["text/plain"]), data[mime].replace("\n", "")
            image = f'<img src="data:{mime};base64,{content}" alt="{alt}">'
            return f'<div class="jp-RenderedImage">{image}</div>'
    return ""
