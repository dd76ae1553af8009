"""Build the course as a website: `make book`, or `python -m course book FOLDER`.

Its pages are the Markdown files of `book/`, the stored notebooks, and the reference of the library, which is generated.
They meet in a temporary folder, which Sphinx reads. A warning is an error.
"""

import base64
import inspect
import pkgutil
import re
import shutil
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from nbformat.v4 import new_output
from sphinx.cmd.build import build_main

import omnistereo_lib as osl
from course import nbtools, stills
from course.dark_mode import picture
from course.figures import draw_figures
from course.readme import STREET, readme_table
from course.teaching import stuck, written

BOOK = nbtools.ROOT / "book"
PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)]+)\)")


def build(out: Path) -> int:
    """Build the website in the folder `out`, in place of an older one; return 0 if there was no warning."""
    with TemporaryDirectory() as folder:
        source, extra, html, trees = (Path(folder, name) for name in ("source", "extra", "html", "trees"))
        assemble(source, extra)
        options = ["-q", "-W", "--keep-going", "-c", str(BOOK), "-d", str(trees)]
        options += ["-D", f"html_extra_path={extra}"]
        if status := build_main(["-b", "html", *options, str(source), str(html)]):
            return status
        if (out / "searchindex.js").is_file():
            shutil.rmtree(out)
        shutil.copytree(html, out, ignore=shutil.ignore_patterns("_sources", ".buildinfo"), dirs_exist_ok=True)
    print(f"Written: {out / 'index.html'}. Open it in a browser; it needs no network.")
    return 0


def assemble(source: Path, extra: Path) -> None:
    """Write all pages into the folder `source`, and the images that they show into `extra`."""
    paths = nbtools.notebooks()
    (source / "reference").mkdir(parents=True)
    generated = {
        "notebooks": readme_table(paths),
        "order": "\n".join(f"notebooks/{path.stem}" for path in paths),
        "names": face(),
        "modules": reference(source),
        "written": written(),
    } | stuck()
    draw_figures(source)
    extra.mkdir()
    shutil.copy(STREET, extra)
    shutil.copytree(nbtools.NOTEBOOKS, source / "notebooks", ignore=shutil.ignore_patterns(".*"))
    for page in BOOK.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for name, part in generated.items():
            text = text.replace(f"<!-- {name} -->", part)
        text = with_pictures(text, source, extra)
        (source / page.name).write_text(text, encoding="utf-8")
    for path in paths:
        nb = for_the_book(nbformat.read(path, as_version=4), path.stem, extra)
        nbformat.write(nb, source / "notebooks" / path.name)


def for_the_book(nb: nbformat.NotebookNode, stem: str, extra: Path) -> nbformat.NotebookNode:
    """Prepare a notebook: images for light and dark mode, stills in place of live figures."""
    live = 0
    for cell in nb.cells:
        if cell.cell_type != "code":
            continue
        for output in cell.outputs:
            data = output.get("data", {})
            for mime in set(nbtools.PICTURES) & set(data):
                shown = picture(base64.b64decode(data[mime]), output.metadata[mime]["alt"], extra, "../")
                output.data = nbformat.from_dict({"text/html": shown})
        for _ in stills.LIVE.findall(cell.source):
            data = {"text/html": stills.shown(stem, live, extra, "../")}
            cell.outputs.append(new_output("display_data", data))
            live += 1
    return nb


def with_pictures(text: str, source: Path, extra: Path) -> str:
    """Return the Markdown of a page with its images for light and dark mode."""
    return PICTURE.sub(lambda found: picture((source / found[2]).read_bytes(), found[1], extra), text)


def reference(source: Path) -> str:
    """Write one page of the reference for each stage of the library; return their table, as Markdown."""
    stages: dict[str, list[str]] = {}
    for module in pkgutil.walk_packages(osl.__path__, "omnistereo_lib."):
        if not module.name.endswith(".__main__"):
            stages.setdefault(module.name.split(".")[1], []).append(module.name)
    rows = []
    for stage, names in stages.items():
        listing = "\n".join(f".. automodule:: {name}\n   :members:\n   :ignore-module-all:\n" for name in names)
        page = f"# {stage}\n\n```{{eval-rst}}\n{listing}```\n"
        (source / "reference" / f"{stage}.md").write_text(page, encoding="utf-8")
        rows.append(f"| [`{stage}`](reference/{stage}.md) | {summary(import_module(names[0]))} |\n")
    return "| module | what it is |\n|---|---|\n" + "".join(rows)


def face() -> str:
    """Return the table of the names that `import omnistereo_lib` offers, as Markdown."""
    rows = [f"| `osl.{name}` | {summary(getattr(osl, name))} |\n" for name in osl.__all__]
    return "| name | what it is |\n|---|---|\n" + "".join(rows)


def summary(thing: object) -> str:
    """Return the first paragraph of a docstring, for a cell of a Markdown table."""
    text = " ".join(inspect.getdoc(thing).partition("\n\n")[0].split())
    return text.replace("|", r"\|").replace("*", r"\*")
