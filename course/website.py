"""Build the course as a website: `make book`, or `python -m course book FOLDER`.

Its pages come from three places: the Markdown files of `book/`, the notebooks as they are stored, and what is
generated from the library: figures, the map of the paper, the reference. They meet in a temporary folder, which Sphinx
reads. A warning is an error.
"""

import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from sphinx.cmd.build import build_main

import omnistereo_lib as osl
from course import nbtools
from course.figures import draw_figures
from course.library import docstrings, modules, summary
from course.paper_map import paper_map
from course.teaching import stuck

BOOK = nbtools.ROOT / "book"
TO_NOTEBOOK = re.compile(r"\[([^\]]+)\]\((?:notebooks/)?(\d\d_\w+\.ipynb)(?:#[^)]*)?\)")
NOT_LISTED = ("__main__",)


def build(out: Path) -> int:
    """Build the website in the folder `out`; 0 when there was nothing to warn of."""
    with TemporaryDirectory() as folder:
        source = Path(folder, "source")
        assemble(source)
        options = ["-q", "-j", "auto", "-W", "--keep-going", "-c", str(BOOK), "-d", str(Path(folder, "doctrees"))]
        return build_main(["-b", "html", *options, str(source), str(out)])


def assemble(source: Path) -> None:
    """Put all pages into one folder."""
    paths = nbtools.notebooks()
    (source / "reference").mkdir(parents=True)
    generated = {
        "notebooks": nbtools.readme_table(paths),
        "map": paper_map(paths),
        "names": face(),
        "modules": reference(source),
    } | stuck()
    for page in BOOK.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for name, part in generated.items():
            text = text.replace(f"<!-- {name} -->", part)
        (source / page.name).write_text(without_dead_links(text), encoding="utf-8")
    shutil.copytree(nbtools.NOTEBOOKS, source / "notebooks", ignore=shutil.ignore_patterns(".*"))
    for path in paths:
        nbformat.write(for_the_book(nbformat.read(path, as_version=4)), source / "notebooks" / path.name)
    draw_figures(source)


def for_the_book(nb: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Prepare a notebook: say the pictures' alternative texts where myst-nb reads them, unlink what is not there."""
    for cell in nb.cells:
        if cell.cell_type == "markdown":
            cell.source = without_dead_links(cell.source)
        outputs = [output for output in cell.get("outputs", []) if "data" in output]
        for output in outputs:
            if caption := output.data.get("text/markdown"):
                output.data["text/markdown"] = without_dead_links(caption)
        alts = [about["alt"] for output in outputs for about in output.metadata.values() if "alt" in about]
        if alts:
            cell.metadata["mystnb"] = {"image": {"alt": " ".join(alts)}}
    return nb


def without_dead_links(text: str) -> str:
    """Return the text with links to notebooks that are not there (yet) as plain words."""
    there = {path.name for path in nbtools.notebooks()}
    return TO_NOTEBOOK.sub(lambda link: link[0] if link[2] in there else link[1], text)


def reference(source: Path) -> str:
    """Write one page of the reference for each stage of the library; return their table, as Markdown."""
    stages: dict[str, list[str]] = {}
    for module in modules():
        stage = module.split(".")[1:2]
        if stage and stage[0] not in NOT_LISTED:
            stages.setdefault(stage[0], []).append(module)
    documented, rows = docstrings(), []
    for stage, names in stages.items():
        listing = "\n".join(f".. automodule:: {name}\n   :members:\n   :ignore-module-all:\n" for name in names)
        page = f"# {stage}\n\n```{{eval-rst}}\n{listing}```\n"
        (source / "reference" / f"{stage}.md").write_text(page, encoding="utf-8")
        rows.append(f"| [`{stage}`](reference/{stage}.md) | {summary(documented[names[0]])} |\n")
    return "| module | what it is |\n|---|---|\n" + "".join(rows)


def face() -> str:
    """Return the table of the names that `import omnistereo_lib` offers, as Markdown."""
    documented = docstrings()
    rows = [
        f"| `osl.{name}` | {summary(documented[f'{getattr(osl, name).__module__}.{name}'])} |\n" for name in osl.__all__
    ]
    return "| name | what it is |\n|---|---|\n" + "".join(rows)
