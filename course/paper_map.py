"""The map of the paper: what in the library and where in the notebooks each of its parts is.

Nothing of it is typed. A docstring that says "paper, Section III-C" or "Eq. 4" puts its function there, so does the
ledger of `course.ledger`, and so does a notebook's text.
"""

import re
from collections import defaultdict
from pathlib import Path

import nbformat
from myst_parser.slugs import github_slugify

from course.claims import CLAIMS
from course.ledger import full_name
from course.library import PACKAGE, docstrings, module_of, modules, summary

# The paper's parts in the order in which it comes to them, and what they are about.
PLACES = {
    "Section I": "introduction",
    "Fig. 1": "rig, images, panorama and depth",
    "Section II": "related work",
    "Section III": "omnidirectional stereo",
    "Section III-A": "the fisheye projection and the calibration",
    "Fig. 2": "the frames of a camera and of the calibration",
    "Section III-B": "the spherical sweep",
    "Eq. 1": "a spherical image",
    "Fig. 3": "images warped onto a sphere",
    "Eq. 2": "the cost volume",
    "Fig. 4": "the whole way from images to depth",
    "Section III-C": "SweepNet and its training",
    "Table I": "SweepNet's layers",
    "Eq. 3": "the labels to train on",
    "Eq. 4": "the loss",
    "Section IV": "the experiments",
    "Fig. 5": "the rendered data sets",
    "Eq. 5": "the error of a ray",
    "Table II": "the errors of all methods",
    "Fig. 6": "a cut through the cost volumes",
    "Fig. 7": "depth on the Sunny set",
    "Fig. 8": "depth on real data",
    "Fig. 9": "depth from the air",
}
_NUMBER = r"(?:[IVX]+(?:-[A-Z])?|\d+[a-z]?)\b"
_MENTION = re.compile(rf"\b(Section|Eq|Table|Fig)s?\.?\s+({_NUMBER}(?:(?:,\s|\sand\s){_NUMBER})*)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def mentions(text: str) -> set[str]:
    """Return the parts of the paper that a text names; "Section III-B and IV" names two.

    "Fig. 2a" is in Fig. 2, and "Section IV-A" in Section IV, whose own parts have headings but no letters.

    Raises:
        ValueError: If it names a part that the paper does not have.
    """
    found = set()
    for kind, numbers in _MENTION.findall(text):
        for number in re.findall(_NUMBER, numbers):
            place = f"{kind}{'.' if kind in ('Eq', 'Fig') else ''} {number.rstrip('abc')}"
            place = place.partition("-")[0] if place not in PLACES else place
            if place not in PLACES:
                raise ValueError(f"{place} is not in the paper, which has {', '.join(PLACES)}; mend: {text[:200]!r}")
            found.add(place)
    return found


def paper_map(notebooks: list[Path]) -> str:
    """Return the map as Markdown: a section for each part of the paper that the library or a notebook names."""
    documented = docstrings()
    names, links = _in_library(documented), _in_notebooks(notebooks)
    sections = []
    for place, title in PLACES.items():
        rows = [_row(name, documented[name]) for name in documented if name in names[place]]
        table = ["| in the library | what it is | file |", "|---|---|---|", *rows, ""] if rows else []
        places = ["In the notebooks:", "", *(f"- {link}" for link in links[place]), ""] if links[place] else []
        if table or places:
            sections += [f"## {place}: {title}", "", *table, *places]
    return "\n".join(sections)


def _in_library(documented: dict[str, str]) -> dict[str, set[str]]:
    """Return the full names of what belongs to each place: by its docstring, or by the ledger."""
    names = defaultdict(set)
    for name, docstring in documented.items():
        for place in mentions(docstring):
            names[place].add(name)
    for claim in CLAIMS:
        for place in mentions(claim.source):
            names[place] |= {full_name(where) for where in claim.where}
    return names


def _in_notebooks(paths: list[Path]) -> dict[str, list[str]]:
    """Return links to the sections of notebooks that name each place."""
    links = defaultdict(list)
    for path in paths:
        cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown"]
        _, title, opening, *parts = _HEADING.split("\n\n".join(cells))  # text, heading, text, heading, text ...
        sections = [(title, "", opening)]
        sections += [
            (f"{path.stem[:2]} · {heading}", f"#{github_slugify(heading)}", text)
            for heading, text in zip(parts[::2], parts[1::2], strict=True)
        ]
        for words, anchor, text in sections:
            for place in mentions(text):
                links[place].append(f"[{words}](notebooks/{path.name}{anchor})")
    return links


def _row(name: str, docstring: str) -> str:
    module = module_of(name)
    short = name.removeprefix(f"{module}.").removeprefix("omnistereo_lib.")
    file = modules()[module].relative_to(PACKAGE)
    return f"| {{py:obj}}`{short} <{name}>` | {summary(docstring)} | `{file}` |"
