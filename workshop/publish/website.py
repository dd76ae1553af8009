"""Build the course as a website: `make book`, or `python -m workshop book FOLDER`.

Its pages are the README, the Markdown files of `book/`, the stored notebooks, and the reference of
the library, which is generated. They meet in a temporary folder, which Sphinx reads. A warning is
an error.
"""

import base64
import re
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote, urlsplit

import nbformat
import yaml
from nbformat.v4 import new_output
from sphinx.cmd.build import build_main

from course import nbtools
from course.figures import stills
from course.figures.dark_mode import LEAST, picture
from omnistereo_lib.errors import OmnistereoError
from workshop.publish.pages import BOOK, README, stages
from workshop.publish.readme import STREET

BESIDE = (
    "what_you_write ten_minutes own_cameras conventions notation glossary prerequisites teaching"
    " exam answers mistakes reproduction training data library promises elsewhere"
)
REDIRECT = (
    '<!DOCTYPE html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{0}</title>\n'
    '<meta http-equiv="refresh" content="0; url={0}.html">\n'
    '<p>This notebook is now <a href="{0}.html">{0}</a>.</p>\n</html>\n'
)
# The figures of the notebooks on the first page, in their order, by the names in captions.yaml.
_FIGURES = ["street and depth", "flat views", "pair of pictures", "focus", "raw depth"]
_FIGURES += ["before and after", "points", "patches", "snapshots", "errors", "regions"]
_FIGURES += ["point cloud", "matches", "own pictures", "witnesses", "lights", "worlds", "mesh"]
BEST = {f"{number:02}": figure for number, figure in enumerate(_FIGURES)}
PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)]+)\)")


def build(out: Path) -> int:
    """Build the website in `out`, in place of an older one; return 0 if nothing was warned of."""
    with TemporaryDirectory() as folder:
        source, extra, html, trees = (
            Path(folder, name) for name in ("source", "extra", "html", "trees")
        )
        assemble(source, extra)
        options = ["-q", "-W", "--keep-going", "-c", str(BOOK), "-d", str(trees)]
        options += ["-D", f"html_extra_path={extra}"]
        if status := build_main(["-b", "html", *options, str(source), str(html)]):
            return status
        if (out / "searchindex.js").is_file():
            shutil.rmtree(out)
        ignored = shutil.ignore_patterns("_sources", ".buildinfo")
        shutil.copytree(html, out, ignore=ignored, dirs_exist_ok=True)
    print(f"Written: {out / 'index.html'}. Open it in a browser; it needs no network.")
    return 0


def assemble(source: Path, extra: Path) -> None:
    """Write all pages into the folder `source`, and the images that they show into `extra`."""
    paths = nbtools.notebooks()
    (source / "reference").mkdir(parents=True)
    extra.mkdir()
    shutil.copy(STREET, extra)
    (extra / "notebooks").mkdir()
    for old, stem in nbtools.MOVED.items():
        (extra / "notebooks" / f"{old}.html").write_text(REDIRECT.format(stem), encoding="utf-8")
    shutil.copytree(nbtools.NOTEBOOKS, source / "notebooks", ignore=shutil.ignore_patterns(".*"))
    for path in (*BOOK.glob("*.png"), *BOOK.glob("*.jpg")):
        shutil.copy(path, source)
    for page in (README, *BOOK.glob("*.md")):
        # The pictures of the front page are photographs, and its table is prose: on a telephone
        # they fit.
        least = 0.0 if page == README else LEAST
        text = with_pictures(with_links(page.read_text(encoding="utf-8")), source, extra, least)
        if page == README:
            text = front_page(text, extra, repository_address())
        (source / page.name).write_text(text, encoding="utf-8")
    front = (source / "README.md").rename(source / "index.md")
    with front.open("a", encoding="utf-8") as file:
        file.write(contents("Notebooks", " ".join(f"notebooks/{path.stem}" for path in paths)))
        file.write(contents("Beside them", BESIDE) + contents("Reference", "reference/*"))
    for path in paths:
        nb = for_the_book(nbformat.read(path, as_version=4), path.stem, extra)
        nbformat.write(nb, source / "notebooks" / path.name)
    for stage, names in stages().items():
        listing = "\n".join(
            f".. automodule:: {name}\n   :members:\n   :ignore-module-all:\n" for name in names
        )
        text = f"# {stage}\n\n```{{eval-rst}}\n{listing}```\n"
        (source / "reference" / f"{stage}.md").write_text(text, encoding="utf-8")


def front_page(text: str, extra: Path, address: str | None) -> str:
    """Return the README as the first page: the viewer below its picture, a figure for each notebook
    in place of the table, the address of the repository where it is known.
    """
    viewer = '<iframe class="view" src="street.html" title="The street" loading="lazy"></iframe>'
    text = text.replace("\n## Start", f"\n{viewer}\n\n## Start", 1)
    shown = f'<div class="cards">\n{cards(extra, address)}\n</div>\n'
    text = re.sub("(?s)<!-- notebooks -->.*<!-- /notebooks -->", lambda _: shown, text)
    text = re.sub(r" A code host shows its source: [^.]*\.", "", text)
    return text.replace("ADDRESS", address) if address else text


def cards(extra: Path, address: str | None) -> str:
    """Return a figure of each notebook with what one learns in it, and where it opens elsewhere."""
    found = []
    for path in nbtools.notebooks():
        nb = nbtools.read_notebook(path)
        facts, number = nb.metadata["omnistereo"], nbtools.number(path)
        title, link = f"{number} {facts['title']}", f"notebooks/{path.stem}.html"
        count, minutes = len(nbtools.open_functions(nb)), facts["minutes_to_read"]
        line = f"{count} functions, {minutes} min to read"
        figure = picture(*best_figure(nb, f"{number} {BEST[number]}"), extra, least=0.0)
        found.append(
            f'<div class="card"><a href="{link}" tabindex="-1" aria-hidden="true">{figure}</a>'
            f'<a href="{link}"><b>{title}</b></a><p>{facts["learn"]}</p><p>{line}'
            + "".join(f' · <a href="{to}">{where}</a>' for where, to in elsewhere(address, path))
            + "</p></div>"
        )
    return "\n".join(found)


def best_figure(nb: nbformat.NotebookNode, name: str) -> tuple[bytes, str]:
    """Return the figure of a notebook that has the name of a caption, and its alternative text."""
    captions = yaml.safe_load((nbtools.NOTEBOOKS / "captions.yaml").read_text(encoding="utf-8"))
    alt = " ".join(captions[name]["alt"].split())
    for cell in nbtools.code_cells(nb):
        for output in cell.outputs:
            for mime in set(nbtools.PICTURES) & set(output.get("data", {})):
                if output.metadata[mime]["alt"] == alt:
                    return base64.b64decode(output.data[mime]), alt
    raise OmnistereoError(f"no output shows the figure {name}. Change BEST in website.py")


def repository_address() -> str | None:
    """Return the address of the repository as git knows it, None unless it is one of the web."""
    command = ["git", "-C", str(nbtools.ROOT), "config", "--get", "remote.origin.url"]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    parts = urlsplit(said)
    # without a password, which a build service may put into it
    return f"https://{parts.hostname}{parts.path}" if parts.scheme in ("http", "https") else None


def elsewhere(address: str | None, notebook: Path) -> list[tuple[str, str]]:
    """Return the places that open a notebook of a repository on GitHub, with their addresses."""
    if not (address or "").startswith("https://github.com/"):
        return []
    repository = (address or "").removeprefix("https://github.com/").removesuffix(".git")
    file = f"notebooks/{notebook.name}"
    return [
        ("Colab", f"https://colab.research.google.com/github/{repository}/blob/main/{file}"),
        ("Binder", f"https://mybinder.org/v2/gh/{repository}/main?labpath={quote(file, safe='')}"),
    ]


def contents(caption: str, names: str) -> str:
    """Return a part of the navigation, in MyST."""
    listed = names.replace(" ", "\n")
    return (
        f"\n```{{toctree}}\n:hidden:\n:titlesonly:\n:glob:\n:caption: {caption}\n\n{listed}\n```\n"
    )


def with_links(text: str) -> str:
    """Return the Markdown of a page with links through the website, not through the clone."""
    text = re.sub(r"\]\((\.\./|book/)", "](", text)
    text = re.sub(
        r"\]\((omnistereo_(?:lib|rigs|learn))/(\w+)(\.py)?\)", r"](reference/\1.\2.md)", text
    )
    text = re.sub(r"\[([^]]+)\]\(street\.html\)", r'<a href="street.html">\1</a>', text)
    text = re.sub(r"\[([^]]+)\]\(notebooks\)", r'<a href="#the-notebooks">\1</a>', text)
    # What the website has no page of: folders, and files beside the pages.
    beside = r"LICENSE|CITATION\.cff|CONTRIBUTING\.md|(?:\w+/)*[a-z_]+/?"
    return re.sub(rf"\[([^]]+)\]\((?:{beside})\)", r"\1", text)


def for_the_book(nb: nbformat.NotebookNode, stem: str, extra: Path) -> nbformat.NotebookNode:
    """Prepare a notebook: its best figure below the title, what is set up and drawn folded, images
    for light and dark mode, stills in place of live figures.
    """
    live, number = 0, stem.partition("_")[0]
    opening = picture(*best_figure(nb, f"{number} {BEST[number]}"), extra, "../", least=0.0)
    title, _, text = nb.cells[0].source.partition("\n")
    nb.cells[0].source = f'{title}\n\n<div class="opening">{opening}</div>\n{text}'
    later = (at for at, cell in enumerate(nb.cells) if at and cell.cell_type == "markdown")
    for cell in (*nb.cells[1 : next(later)], *nbtools.drawing_cells(nb)):
        cell.metadata["tags"] = [*cell.metadata.get("tags", ()), "hide-input"]
    for cell in nb.cells:
        if cell.cell_type != "code":
            cell.source = cell.source.replace("](../book/", "](../")
            continue
        for output in cell.outputs:
            data = output.get("data", {})
            for mime in set(nbtools.PICTURES) & set(data):
                shown = picture(
                    base64.b64decode(data[mime]), output.metadata[mime]["alt"], extra, "../"
                )
                output.data = nbformat.from_dict({"text/html": shown})
        for _ in stills.LIVE.findall(cell.source):
            data = {"text/html": stills.shown(stem, live, extra, "../")}
            cell.outputs.append(new_output("display_data", data))
            live += 1
    return nb


def with_pictures(text: str, source: Path, extra: Path, least: float) -> str:
    """Return the Markdown of a page with its images for light and dark mode."""
    return PICTURE.sub(
        lambda found: picture((source / found[2]).read_bytes(), found[1], extra, least=least), text
    )
