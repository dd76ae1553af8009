"""Make slides of the notebooks: `make slides`, or `python -m workshop slides FOLDER`.

nbconvert writes each notebook as one page, and deal.js, beside it, deals the page out to slides in
the browser: it begins a slide at each heading, and where the next piece does not fit. What
book/slides/NUMBER.yaml says is shown: on each slide an idea, one figure, formula or function of
the notebook, and a sentence.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides
need no network.
"""

import base64
import html
import io
import json
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import nbformat
import numpy as np
import yaml
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_markdown_cell, new_notebook
from numpy.typing import NDArray
from PIL import Image

from course import nbtools
from course.classroom import solve
from course.figures.plot import DPI
from omnistereo_lib.errors import OmnistereoError
from workshop.publish.website import BEST

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(
    find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js"
)
BOOK = nbtools.ROOT / "book"
TEMPLATE = BOOK / "slides_template"
WRITTEN = BOOK / "slides"
SCRIPTS = (MATHJAX, TEMPLATE / "deal.js")
DOCSTRING = re.compile(r'^ +""".*?"""\n', re.DOTALL | re.MULTILINE)
WHITE = 205  # a pixel at least this bright is paper: 204 is a patch of grey
# px of the 10 pt in which Matplotlib labels axes
LABEL = {f"image/{kind}": round(10 * dpi / 72, 1) for kind, dpi in DPI.items()}
SENTENCE = re.compile(r"(?<=[.?]) (?=[A-Z])")
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
        title = html.escape(f"{nbtools.number(path)} {facts['title']}")
        learn = html.escape(facts["learn"])
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
            tab.evaluate("Reveal.configure({ controls: false, progress: false })")
            shots = []
            for place in tab.evaluate("Reveal.getSlides().map(s => Reveal.getIndices(s))"):
                tab.evaluate("([h, v]) => Reveal.slide(h, v, 99)", [place["h"], place.get("v", 0)])
                shots.append(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))
            pdf = page.with_name(page.name.replace(".slides.html", ".pdf"))
            shots[0].save(pdf, save_all=True, append_images=shots[1:], resolution=144)
            print(f"Written: {pdf}, {len(shots)} slides")
        browser.close()


def shown(nb: NotebookNode, number: str) -> Iterator[NotebookNode]:
    """Yield the cells of a notebook's slides: an idea, what there is to see, a sentence."""
    script = yaml.safe_load((WRITTEN / f"{number}.yaml").read_text(encoding="utf-8"))
    figures = {
        name: output
        for cell in nbtools.code_cells(nb)
        for name, output in zip(SHOWN.findall(cell.source), pictures_of(cell), strict=False)
    }
    cuts = {slide["figure"]: slide for slide in script if "figure" in slide}
    best, learn = f"{number} {BEST[number]}", nb.metadata["omnistereo"]["learn"]
    yield new_markdown_cell(nb.cells[0].source.partition("\n")[0])
    yield new_markdown_cell(picture(figures[best], **cuts.get(best, {})))
    yield new_markdown_cell(f"{learn[0].upper()}{learn[1:]}.")
    solutions = folded_solutions(nb)
    stubs = {s.name: cell for cell in nbtools.code_cells(nb) for s in solve.stubs(cell.source)}
    for slide in script:
        yield new_markdown_cell(f"<h2 class='slide'>{html.escape(slide['idea'])}</h2>")
        if "figure" in slide:
            yield new_markdown_cell(picture(figures[slide["figure"]], **slide))
        if "formula" in slide:
            yield new_markdown_cell(f"$$ {slide['formula']} $$")
        say = slide["say"]
        if not slide.keys() & {"figure", "formula", "function"}:
            say = SENTENCE.sub("\n- ", f"- {say}")
        yield new_markdown_cell(say)
        if "function" in slide:
            yield stubs[slide["function"]]
            yield new_markdown_cell(solutions[slide["function"]])


def folded_solutions(nb: NotebookNode) -> dict[str, str]:
    """Return the folds with the solutions of a notebook, without the docstrings its stubs have."""
    text = "\n".join(cell.source for cell in nb.cells)
    folds = {
        fold[2]: DOCSTRING.sub("", fold[0], count=1) for fold in nbtools.SOLUTION.finditer(text)
    }
    return {name: f"{fold}\n```\n</details>" for name, fold in folds.items()}


def pictures_of(cell: NotebookNode) -> list[NotebookNode]:
    """Return the outputs of a cell that are pictures."""
    return [o for o in cell.outputs if {*nbtools.PICTURES} & {*o.get("data", {})}]


def picture(output: NotebookNode, rows: int = 1, columns: int = 1, **_: str) -> str:
    """Return a picture as HTML, with where deal.js may cut it: `rows` where all of it would be too
    small to be projected, `columns` on a telephone.
    """
    (mime,) = {*nbtools.PICTURES} & {*output.data}
    alt, content = html.escape(output.data["text/plain"]), output.data[mime].replace("\n", "")
    image = Image.open(io.BytesIO(base64.b64decode(content)))
    ink = np.asarray(image.convert("L")) < WHITE
    # a colour bar at the right may be common to the rows
    left = ink[:, : int(0.85 * image.width)]
    boxes = {
        # a single pixel of a row is noise that JPEG leaves around letters
        "rows": parts(left.sum(axis=1) > 1, rows),
        "columns": parts(np.any(ink, axis=0), columns),
    }
    facts = "".join(f" data-{name}='{json.dumps(found)}'" for name, found in boxes.items())
    size = f'width="{image.width}" height="{image.height}"'
    shown = f'<img src="data:{mime};base64,{content}" {size} alt="{alt}">'
    return f'<div class="picture" data-label="{LABEL[mime]}"{facts}>{shown}</div>'


def parts(ink: NDArray[np.bool_], count: int) -> list[tuple[int, int]]:
    """Return where `count` parts begin and end along an axis: between them is the most paper."""
    (at,) = np.nonzero(ink)
    cuts: list[int] = []
    ends, least = [at[0], at[-1]], 0.45 * (at[-1] - at[0]) / count
    for k in np.argsort(-np.diff(at), kind="stable"):
        if len(cuts) + 1 < count and all(abs(at[k] - end) > least for end in ends):
            cuts.append(k)
            ends.append(at[k])
    inner = sorted(cuts)
    starts, stops = [at[0], *at[[k + 1 for k in inner]]], [*at[inner], at[-1]]
    return [(int(a), int(b) + 1) for a, b in zip(starts, stops, strict=True)]
