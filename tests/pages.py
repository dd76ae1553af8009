"""Pages of HTML, read for what they link to, show and fetch."""

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat

from course import nbtools
from course.figures import stills

# what a page fetches
LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}


@dataclass
class Page(HTMLParser):
    """What a page has, links to, shows and fetches."""

    path: Path
    ids: set = field(default_factory=set)
    links: list = field(default_factory=list)
    fetched: list = field(default_factory=list)
    pictures: list = field(default_factory=list)
    formulas: list = field(default_factory=list)

    def __post_init__(self):
        super().__init__()
        self.in_formula = False
        self.feed(self.path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        has = dict(attributes)
        self.ids.add(has.get("id"))
        if tag == "a" and "href" in has:
            self.links.append(has["href"])
        if address := has.get(LOADS.get(tag, "")) or has.get("data-src"):
            self.fetched.append(address)
        if tag == "img":
            self.pictures.append(has)
        self.in_formula = "math" in has.get("class", "").split()

    def handle_data(self, text):
        if self.in_formula and text.startswith((r"\(", r"\[")):
            self.formulas.append(text)


def leads(page, link, pages):
    address = urlsplit(link)
    if address.scheme or address.netloc:  # another host's
        return True
    target = (page.path.parent / unquote(address.path)).resolve() if address.path else page.path
    if not address.fragment or target.suffix != ".html":
        return target.exists()
    return target in pages and unquote(address.fragment) in pages[target].ids


def foreign_or_missing(page):
    """Yield what a page fetches from other hosts or does not find, except from itself."""
    for address in map(urlsplit, page.fetched):
        if address.scheme != "data" and (
            address.netloc or not (page.path.parent / unquote(address.path)).exists()
        ):
            yield f"{page.path.name} → {address.geturl()}"


def count_pictures(path):
    """How many pictures a notebook holds."""
    nb = nbformat.read(path, as_version=4)
    texts = sum(
        len(re.findall(r"!\[[^\]]+\]\(", cell.source))
        for cell in nb.cells
        if cell.cell_type == "markdown"
    )
    outputs = [output for cell in nbtools.code_cells(nb) for output in cell.outputs]
    return texts + sum(
        bool(set(nbtools.PICTURES) & set(output.get("data", {}))) for output in outputs
    )


def count_stills(path):
    sliders = [slider for live in stills.stored(path.stem) for slider in live.get("sliders", [])]
    # where all stand at first
    repeated = sum(len(live.get("sliders", [0])) - 1 for live in stills.stored(path.stem))
    return sum(len(slider["values"]) for slider in sliders) - repeated
