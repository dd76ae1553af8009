"""Make slides of the notebooks: `make slides`, or `python -m course slides FOLDER`.

They follow from a notebook's structure; nothing is marked in it:

- A section (##) is a column of slides. A slide takes what fits of it, the next one below takes on; ### begins one, too.
- A cell that draws shows its picture and the caption, in the room that the text before it leaves. Other code is shown
  where it fits on one slide together with what it printed; longer code is left out, and only what it printed is shown.
- A sentence does not get a slide to itself where code or printed text can go with it.
- A live figure shows its stills, or the viewer. An open function is followed by its solution, at the next step.
- Left out are imports, the check of the installation, and what prints more than a slide can hold.

reveal.js comes with the package sphinx-revealjs, MathJax with sphinx-mathjax-offline: the slides need no network.
"""

import ast
import base64
import html
import io
import math
import re
import shutil
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from markdown_it import MarkdownIt
from nbconvert import SlidesExporter
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from PIL import Image

from course import nbtools, solve, stills

REVEAL = Path(find_spec("sphinx_revealjs").submodule_search_locations[0], "_static/revealjs")
MATHJAX = Path(find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js")
SCRIPT = nbtools.ROOT / "book" / "stills.js"
WIDTH, HEIGHT = 1280, 720  # pixels, as all that follows
FULL = 675.0  # of them to be filled
TEXT, CODE, OUTPUT, CAPTION = (33.0, 88), (29.0, 82), (29.0, 76), (29.0, 104)  # height of a line, letters in it
HEADINGS = {"#": 90.0, "##": 75.0, "###": 60.0}
MARGIN = 16.0
LITTLE = 250.0  # a heading and a sentence or two
PICTURE = (240.0, 325.0)  # at least, a wide one and a tall one
HIDDEN, SOLUTION = "hide-input", "solution"
EXERCISE = re.compile(r"\*\*\d\d\.\d+ \(")
FOLD = re.compile(r"<details>.*?\n```\n|</details>", re.DOTALL)
LINK = re.compile(r'<a href="(\d\d_\w+)\.ipynb[^"]*">(.*?)</a>')  # to another notebook


def make_slides(out: Path) -> None:
    """Write a page of slides for each notebook, the page that leads to them, and the scripts that show them."""
    out.mkdir(parents=True, exist_ok=True)
    shutil.copytree(REVEAL / "dist", out / "reveal.js/dist", ignore=shutil.ignore_patterns("*.map"), dirs_exist_ok=True)
    for file, folder in ((REVEAL / "LICENSE", out / "reveal.js"), (MATHJAX, out), (SCRIPT, out)):
        shutil.copy(file, folder)
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
    entries, stems = [], [path.stem for path in nbtools.notebooks()]
    for path in nbtools.notebooks():
        nb = with_live(nbformat.read(path, as_version=4), path.stem, out)
        page, _ = exporter.from_notebook_node(deal(nb), {"metadata": {"name": path.stem}})
        page = LINK.sub(
            lambda link: f'<a href="{link[1]}.slides.html">{link[2]}</a>' if link[1] in stems else link[2], page
        )
        (out / f"{path.stem}.slides.html").write_text(page, encoding="utf-8")
        facts = nb.metadata["omnistereo"]
        title = html.escape(f"{path.stem[:2]} {facts['title']}")
        entries.append(f'<li><a href="{path.stem}.slides.html">{title}</a>: {html.escape(facts["learn"])}</li>')
    index = (nbtools.ROOT / "book" / "slides_template" / "list.html").read_text(encoding="utf-8")
    (out / "index.html").write_text(index.replace("{entries}", "\n".join(entries)), encoding="utf-8")
    print(f"Written: {out / 'index.html'}. Open it in a browser; it needs no network.")


def with_live(nb: NotebookNode, stem: str, out: Path) -> NotebookNode:
    """Return a notebook with a cell for each live figure, which shows what is stored of it."""
    cells, number = [], 0
    for cell in nb.cells:
        cells.append(cell)
        live = stills.LIVE.findall(cell.source) if cell.cell_type == "code" else []
        if live and not cell.outputs:
            cells.pop()
        for _ in live:
            output = new_output("display_data", {"text/html": stills.shown(stem, number, out)})
            cells.append(new_code_cell("", outputs=[output]))
            number += 1
    return new_notebook(cells=cells, metadata=nb.metadata)


def deal(nb: NotebookNode) -> NotebookNode:
    """Deal a notebook's pieces out to slides: a new notebook, whose cells say where a slide begins."""
    slides: list[list[NotebookNode]] = []
    for cell in pieces(nb):
        here = slides[-1] if slides else []
        begins = _begins(cell)
        if not here or (begins and not all(map(_is_heading, here))):
            slides.append([cell])
        elif sum(map(height, here)) + height(cell) <= FULL:
            here.append(cell)
        else:
            slides.append([*_introduction(here, cell), cell])
    _give_company(slides)
    slides = _merge(slides)
    for first, *others in slides:
        first.metadata["slideshow"] = {"slide_type": "slide" if first.source.startswith(("# ", "## ")) else "subslide"}
        for cell in others:
            solution = SOLUTION in cell.metadata.get("tags", [])
            cell.metadata["slideshow"] = {"slide_type": "fragment" if solution else "-"}
    return new_notebook(cells=[cell for slide in slides for cell in slide], metadata=nb.metadata)


def _introduction(here: list[NotebookNode], cell: NotebookNode) -> list[NotebookNode]:
    """Take from a slide the last sentence, to stand with the code or picture that it introduces."""
    *before, last = here
    stays = cell.cell_type == "markdown" or last.cell_type == "code" or all(map(_is_heading, before))
    return [] if stays or height(last) + height(cell) > FULL else [here.pop()]


def _give_company(slides: list[list[NotebookNode]]) -> None:
    """Put a sentence that has a slide to itself beside the code that follows, or beside what the code before printed.

    For that the code and what it printed go to two slides.
    """
    for before, here, after in zip([[], *slides], slides, [*slides[1:], []], strict=False):
        if sum(map(height, here)) > LITTLE or any(cell.cell_type == "code" for cell in here):
            continue
        if after and _can_split(after[0]):
            code, output = _split(after[0])
            if sum(map(height, [*here, code])) <= FULL:
                here.append(code)
                after[0] = output
        elif before and not _is_heading(here[0]) and _can_split(before[-1]):
            code, output = _split(before[-1])
            if sum(map(height, [output, *here])) <= FULL:
                before[-1] = code
                here.insert(0, output)


def _merge(slides: list[list[NotebookNode]]) -> list[list[NotebookNode]]:
    """Join a slide to the one before where both fit on one and no section or exercise begins."""
    merged = slides[:1]
    for slide in slides[1:]:
        if not _begins(slide[0]) and sum(map(height, [*merged[-1], *slide])) <= FULL:
            merged[-1] = [*merged[-1], *slide]
        else:
            merged.append(slide)
    return merged


def _begins(cell: NotebookNode) -> bool:
    """Say whether a piece begins a slide: a heading, or an exercise."""
    return _is_heading(cell) or EXERCISE.match(cell.source) is not None


def _can_split(cell: NotebookNode) -> bool:
    return cell.cell_type == "code" and cell.outputs and not {HIDDEN, SOLUTION} & set(cell.metadata.get("tags", []))


def _split(cell: NotebookNode) -> tuple[NotebookNode, NotebookNode]:
    """Return a cell's code and its output as two cells."""
    tags = [*cell.metadata.get("tags", []), HIDDEN]
    output = new_code_cell(cell.source, outputs=cell.outputs, metadata={"tags": tags})
    return new_code_cell(cell.source, metadata=cell.metadata), output


def pieces(nb: NotebookNode) -> Iterator[NotebookNode]:
    """Yield what the slides show of a notebook: blocks of text one by one, and cells of code."""
    codes = iter(narrow([_shown_code(cell) for cell in nb.cells if cell.cell_type == "code" or _solution(cell)]))
    for cell in nb.cells:
        if _solution(cell):
            yield new_code_cell(next(codes), metadata={"tags": [SOLUTION]})
            cell = new_markdown_cell(FOLD.sub("", cell.source))
        if cell.cell_type == "markdown":
            lines = cell.source.splitlines()
            tokens = MarkdownIt().enable("table").parse(cell.source)
            blocks = [token.map for token in tokens if token.level == 0 and token.map]
            yield from (new_markdown_cell("\n".join(lines[first:last])) for first, last in blocks)
            continue
        code = next(codes)
        if _asked_at_the_end(cell):
            cell = new_code_cell(code, metadata={"tags": [SOLUTION]})
        elif cell.source == nbtools.SETUP or (not cell.outputs and _imports(cell)):
            continue
        cell.source = code
        if has_picture(cell) or height(cell) > FULL - HEADINGS["##"]:
            cell.metadata["tags"] = [*cell.metadata.get("tags", []), HIDDEN]
        if (cell.outputs or HIDDEN not in cell.metadata.get("tags", [])) and height(cell) <= FULL:
            yield cell


def _solution(cell: NotebookNode) -> re.Match | None:
    """Return the folded solution in a cell of text, if there is one."""
    return nbtools.SOLUTION.search(cell.source) if cell.cell_type == "markdown" else None


def _asked_at_the_end(cell: NotebookNode) -> list[str]:
    """Return the names of the stubs of an exercise that is not in the flow yet."""
    return [stub.name for stub in solve.stubs(cell.source) if stub.name in solve.ANSWERS]


def _shown_code(cell: NotebookNode) -> str:
    """Return a cell's code; of an exercise its solution, without the checker."""
    if solution := _solution(cell):
        return solution[3]
    return "\n\n\n".join(map(solve.inspect.getsource, map(solve.ANSWERS.get, _asked_at_the_end(cell)))) or cell.source


def narrow(codes: list[str]) -> list[str]:
    """Return code in lines that a slide can hold, formatted by Ruff; strings and comments may stay longer."""
    with TemporaryDirectory() as folder:
        paths = [Path(folder, f"cell_{number}.py") for number in range(len(codes))]
        for path, code in zip(paths, codes, strict=True):
            path.write_text(_comments_above(code.replace("  # fmt: skip", "")), encoding="utf-8")
        command = [sys.executable, "-m", "ruff", "format", "--quiet", "--isolated", f"--line-length={CODE[1]}", folder]
        subprocess.run(command, check=True)
        return [path.read_text(encoding="utf-8").rstrip("\n") for path in paths]


def _comments_above(code: str) -> str:
    """Put the comments of long lines on lines of their own, so that Ruff need not break the code before them."""
    lines = code.splitlines()
    for token in reversed(list(tokenize.generate_tokens(io.StringIO(code).readline))):
        (row, column), line = token.start, lines[token.start[0] - 1] if token.start[0] <= len(lines) else ""
        if token.type == tokenize.COMMENT and line[:column].strip() and len(line) > CODE[1]:
            lines[row - 1 : row] = [line[: len(line) - len(line.lstrip())] + token.string, line[:column].rstrip()]
    return "\n".join(lines)


def height(cell: NotebookNode) -> float:
    """Return how much of a slide's height a piece takes, its margins included."""
    if cell.cell_type == "markdown":
        if _is_heading(cell):
            return HEADINGS[cell.source.partition(" ")[0]]
        scale = 2.0 if cell.source.startswith("$$") else 1.3 if cell.source.startswith("|") else 1.0
        return scale * _lines(cell.source, TEXT) + MARGIN
    shown = "" if HIDDEN in cell.metadata.get("tags", []) else cell.source
    captions = [output.get("data", {}).get("text/markdown", "") for output in cell.outputs]
    texts = [(shown, CODE), *((output.get("text", ""), OUTPUT) for output in cell.outputs)]
    texts += [(caption, CAPTION) for caption in captions]
    pictures = sum(_picture_height(output.get("data", {})) for output in cell.outputs)
    return pictures + sum(_lines(text, kind) + 1.5 * MARGIN for text, kind in texts if text)


def has_picture(cell: NotebookNode) -> bool:
    """Say whether a cell shows a picture, or something as large."""
    return any(_picture_height(output.get("data", {})) for output in cell.get("outputs", []))


def _picture_height(data: dict) -> float:
    for mime in set(nbtools.PICTURES) & set(data):
        width, height = Image.open(io.BytesIO(base64.b64decode(data[mime]))).size
        return min(max(PICTURE[0], 0.7 * WIDTH * height / width), PICTURE[1])
    return PICTURE[1] if "text/html" in data else 0.0  # stills, or the viewer


def _is_heading(cell: NotebookNode) -> bool:
    return cell.cell_type == "markdown" and cell.source.partition(" ")[0] in HEADINGS


def _lines(text: str, kind: tuple[float, int]) -> float:
    line, letters = kind
    return line * sum(max(1, math.ceil(len(words) / letters)) for words in text.splitlines())


def _imports(cell: NotebookNode) -> bool:
    return all(isinstance(node, ast.Import | ast.ImportFrom) for node in ast.parse(cell.source).body)
