"""Make slides of the notebooks: `make slides`, or `python -m workshop slides FOLDER`.

nbconvert writes each notebook as one page, and deal.js, beside it, deals the page out to slides in
the browser: it begins a slide at each heading, and where the next piece does not fit. Slides
that were written, in book/slides/NUMBER.yaml, show an idea each, with one figure, formula or
function of the notebook and a sentence. Of the other notebooks `cut` says what is shown; a cell
with the tag `skip` is left out.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides
need no network.
"""

import copy
import html
import io
import itertools
import re
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import nbformat
import yaml
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_markdown_cell, new_notebook, new_output
from PIL import Image

from course import nbtools
from course.classroom import solve
from course.exercises.opened import YOURS_TO_WRITE
from course.figures import stills
from omnistereo_lib.errors import OmnistereoError

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(
    find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js"
)
BOOK = nbtools.ROOT / "book"
TEMPLATE = BOOK / "slides_template"
WRITTEN = BOOK / "slides"
SCRIPTS = (MATHJAX, BOOK / "stills.js", TEMPLATE / "deal.js")
LEFT_OUT = {"## Exercises", "## Common errors", "## Further reading"}
BLOCK = re.compile(r"<details>.*?</details>|```.*?```|\$\$.*?\$\$|\S.*?(?=\n\s*\n|\Z)", re.DOTALL)
SENTENCE = re.compile(r"(?<=[.!?])(?<!\bEq\.)(?<!\bFig\.)\s+(?=[A-Z*`$\[])")
DOCSTRING = re.compile(r'^ +""".*?"""\n', re.DOTALL | re.MULTILINE)
SHOWN = re.compile(r'\bshow\(.*, "([^"]+)"\)')  # the name of a figure
LINK = re.compile(r'<a href="(\d\d_\w+)\.ipynb[^"]*">(.*?)</a>')  # to another notebook


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
    entries, stems = [], [path.stem for path in nbtools.notebooks()]
    for path in paths:
        nb = nbformat.read(path, as_version=4)
        cells = list(shown(nb, path.stem, out))
        page, _ = exporter.from_notebook_node(
            new_notebook(cells=cells, metadata=nb.metadata | {"title": path.stem})
        )
        page = LINK.sub(
            lambda link: (
                f'<a href="{link[1]}.slides.html">{link[2]}</a>' if link[1] in stems else link[2]
            ),
            page,
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


def shown(nb: NotebookNode, stem: str, out: Path) -> Iterator[NotebookNode]:
    """Yield the cells of a notebook's slides."""
    script = WRITTEN / f"{stem.partition('_')[0]}.yaml"
    yield from written(nb, script) if script.is_file() else cut(nb, stem, out)


def written(nb: NotebookNode, script: Path) -> Iterator[NotebookNode]:
    """Yield the cells of slides that were written: an idea, a sentence, what there is to see."""
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


def cut(nb: NotebookNode, stem: str, out: Path) -> Iterator[NotebookNode]:
    """Yield the cells that the slides show of a notebook: what a room needs, the notebook has the
    rest.

    Headings, formulas, lists, and of each paragraph the first sentence; on the title slide the
    first picture. Of code the functions that are left open, each as "Your turn", with its solution
    at the next step; else what it shows. Of a live figure its stills. Not the exercises, common
    errors and further reading at the end.
    """
    live, section = 0, ""
    solutions = folded_solutions(nb)
    for cell in nb.cells:
        tags = cell.metadata.setdefault("tags", [])
        if cell.cell_type == "markdown":
            kept = []
            for block in BLOCK.findall(cell.source):
                section = block if re.match("##? ", block) else section
                if section not in LEFT_OUT and not block.startswith("<details>"):
                    kept.append(in_short(block))
            cell.source = "\n\n".join(kept)
            if cell is nb.cells[0]:
                cell.source += f"\n\n{first_picture(nb)}"
        elif section in LEFT_OUT or cell.source.endswith(nbtools.SETUP):
            continue
        elif stubs := [stub.name for stub in solve.stubs(cell.source)]:
            yield new_markdown_cell("\n\n".join(f"### Your turn: `{name}`" for name in stubs))
            yield cell
            cell = new_markdown_cell("\n\n".join(solutions[name] for name in stubs))
        else:
            for _ in stills.LIVE.findall(cell.source):
                figure = stills.shown(stem, live, out).replace(
                    '<iframe class="view" src', '<iframe class="view" data-src'
                )
                cell.outputs.append(new_output("display_data", {"text/html": figure}))
                live += 1
            # with their captions
            pictures = [output for output in cell.outputs if "data" in output]
            cell.outputs = pictures or [
                output for output in cell.outputs if YOURS_TO_WRITE not in output.text
            ]
            tags.append("hide-input")
            if not cell.outputs:
                continue
        if cell.source and "skip" not in tags:
            yield cell


def in_short(block: str) -> str:
    """Return a block of Markdown, but of a paragraph its first sentence, unless that ends within
    its emphasis.
    """
    first, *others = SENTENCE.split(block, maxsplit=1)
    is_prose = re.match(r"[\w*_`$(\[\"“‘]", block) and not re.match(r"(\*|\d+\.) |\$\$", block)
    return (
        first
        if others and is_prose and first.count("*") % 2 == first.count("$") % 2 == 0
        else block
    )


def first_picture(nb: NotebookNode) -> str:
    """Return the first picture of a notebook as HTML."""
    for output in itertools.chain(*(cell.outputs for cell in nbtools.code_cells(nb))):
        for mime in set(nbtools.PICTURES) & set(output.get("data", {})):
            picture, alt = (
                output.data[mime].replace("\n", ""),
                html.escape(output.data["text/plain"]),
            )
            return (
                f'<div class="jp-RenderedImage"><img src="data:{mime};base64,{picture}"'
                f' alt="{alt}"></div>'
            )
    return ""
