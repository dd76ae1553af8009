"""The rules for a notebook of the course: `python -m workshop lint notebooks/00_quickstart.ipynb`.

course/template.ipynb says what goes where. A notebook states facts about itself in its metadata,
under "omnistereo":

    {"title": "Quick start", "learn": "...", "needs": "CPU", "minutes_to_read": 10, "budget_s": 60}
"""

import re
import statistics
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import nbformat

from course import nbtools

FACTS = {"title": str, "learn": str, "needs": str, "minutes_to_read": int, "budget_s": int}
MAX_BUDGET_S = 60
MAX_BYTES = 800_000
MAX_CELL_LINES, MAX_MEDIAN_LINES, MAX_LINES = 30, 10, 400
OPENING = re.compile(
    r"# .+\*\*You will\*\* .+\*\*Before you start:\*\* .+\*\*Next:\*\* ", re.DOTALL
)
CLOSING = ["## Exercises", "## Common errors", "## Takeaways", "## Further reading"]
# **03.1 (warm-up).**
EXERCISE = re.compile(r"^\*\*\d\d\.\d+(?: \(([\w -]+)\))?\.\*\*", re.MULTILINE)
LEVELS = ["warm-up", "medium", "hard", "open"]
KINDS = ["experiment", "case", "open question"]  # of exercises behind open functions


def lint(paths: list[Path]) -> bool:
    """Print what is wrong with stored notebooks; return whether nothing is."""
    return report({path: problems(nbtools.read_text(path)) for path in paths})


def report(found: dict[Path, list[str]]) -> bool:
    """Print what is wrong with some notebooks; return whether nothing is."""
    for path, lines in found.items():
        print(*(f"{path.name}: {line}\n" for line in lines), sep="", end="", file=sys.stderr)
    return not any(found.values())


def problems(text: str) -> list[str]:
    """Return what is wrong with a notebook, given as the text of its file. Empty if valid."""
    nb = nbformat.reads(text, as_version=4)
    found = [*_facts(nb), *_runs(nb), *_lengths(nb), *_outputs(nb), *_pictures(nb), *_frame(nb)]
    if len(text.encode()) > MAX_BYTES:
        found.append(
            f"{len(text.encode()) // 1000} KB; at most {MAX_BYTES // 1000}: smaller pictures"
        )
    if text != nbtools.text_of(nbtools.clean(nb)):
        found.append(
            "not clean (widget state, ids, timings, ...): `python -m workshop clean` fixes it"
        )
    return found


def _facts(nb: nbformat.NotebookNode) -> Iterator[str]:
    facts = nb.metadata.get("omnistereo", {})
    if set(facts) != set(FACTS) or not all(
        isinstance(facts[key], kind) for key, kind in FACTS.items()
    ):
        needed = ", ".join(f"{key} ({kind.__name__})" for key, kind in FACTS.items())
        yield f"metadata.omnistereo holds {dict(facts)}; it needs {needed}"
    elif not 0 < facts["budget_s"] <= MAX_BUDGET_S:
        yield f"budget_s is {facts['budget_s']}; at most {MAX_BUDGET_S} on two cores"


def _runs(nb: nbformat.NotebookNode) -> Iterator[str]:
    cells = nbtools.code_cells(nb)
    setup = nbtools.setup_of(nb)
    if not cells or cells[0].source != setup:
        yield f"the first code cell is not the common one:\n{setup}"
    counts = [cell.execution_count for cell in cells]
    if counts != list(range(1, len(cells) + 1)):
        yield f"not run in order from a fresh kernel: counts {counts}"
    if not any(cell.outputs for cell in cells):
        yield "no cell has an output, so nothing can be compared"


def _lengths(nb: nbformat.NotebookNode) -> Iterator[str]:
    lines = [len(cell.source.splitlines()) for cell in nbtools.code_cells(nb)]
    if max(lines, default=0) > MAX_CELL_LINES:
        yield f"a code cell of {max(lines)} lines; at most {MAX_CELL_LINES}"
    if lines and statistics.median(lines) > MAX_MEDIAN_LINES:
        yield (
            f"code cells of {statistics.median(lines)} lines in the median; at most"
            f" {MAX_MEDIAN_LINES}"
        )
    if sum(lines) > MAX_LINES:
        yield f"{sum(lines)} lines of code in all; at most {MAX_LINES}"


def _outputs(nb: nbformat.NotebookNode) -> Iterator[str]:
    for number, cell in enumerate(nbtools.code_cells(nb), start=1):
        tags = cell.metadata.get("tags", [])
        if any(line.rstrip().endswith(";") for line in cell.source.splitlines()):
            yield f"cell {number}: a line ends in ';', which hides an output, but not from nbval"
        for output in cell.outputs:
            data = output.get("data", {})
            said = output.get("text", "") + "".join(
                str(data[mime]) for mime in data if mime not in nbtools.PICTURES
            )
            if output.output_type == "error" and "raises-exception" not in tags:
                yield f"cell {number}: {output.ename}, without the tag raises-exception"
            if output.get("name") == "stderr":
                yield f"cell {number}: a warning; fix its cause: {output.text.strip()[:200]}"
            if "image/svg+xml" in data:
                yield f"cell {number}: an SVG picture, which differs in every run; use PNG"
            if re.search(r"\b0x[0-9a-f]{6,}|(?<![\w.~-])/(home|Users|root|tmp)/", said):
                yield f"cell {number}: a memory address or a path of this machine in its output"
            if "\r" in said:
                yield f"cell {number}: a progress bar in its output; print a line or nothing"


def _pictures(nb: nbformat.NotebookNode) -> Iterator[str]:
    """Every picture has an alternative text and a caption, from captions.yaml."""
    for number, cell in enumerate(nbtools.code_cells(nb), start=1):
        for output, after in pairwise([*cell.outputs, {}]):
            data, caption = output.get("data", {}), after.get("data", {}).get("text/markdown", "")
            for mime in set(nbtools.PICTURES) & set(data):
                alt = output.metadata.get(mime, {}).get("alt", "")
                if len(alt) < 20 or data.get("text/plain") != alt:
                    yield f"cell {number}: a picture without alternative text; use show(fig, name)"
                if not caption.startswith("*Figure:* "):
                    yield f"cell {number}: a picture without a caption; use show(fig, name)"
    undescribed = re.compile(r"""!\[\s*\]\(|<img(?![^>]*\balt=["'][^"'])""")
    for cell in nb.cells:
        if cell.cell_type == "markdown" and undescribed.search(cell.source):
            yield "a picture in the text without alternative text: ![what it shows](file)"


def _frame(nb: nbformat.NotebookNode) -> Iterator[str]:
    """Every notebook opens and closes in the same way."""
    prose = [cell.source for cell in nb.cells if cell.cell_type == "markdown"]
    if not prose or not OPENING.match(prose[0]):
        yield "its first text is not: # title, **You will** …, **Before you start:** …, **Next:** …"
    sections = re.findall(r"^## .+", "\n".join(prose), re.MULTILINE)[-len(CLOSING) :]
    if sections != CLOSING:
        yield f"its last sections are {sections}; they must be {CLOSING}"
    levels = EXERCISE.findall("\n".join(prose))
    if nbtools.open_functions(nb):
        if not 2 <= len(levels) <= 4 or set(levels) - set(KINDS):
            yield f"its exercises are marked {levels}; two to four, each one of {KINDS}"
        return
    rising = set(levels) <= set(LEVELS) and levels == sorted(levels, key=LEVELS.index)
    if not rising or {"warm-up", "open"} - set(levels):
        yield f"its exercises are marked {levels}; from (warm-up) to (open), out of {LEVELS}"


def prose(nb: nbformat.NotebookNode) -> Iterator[str]:
    """Yield text cells and captions."""
    yield from (cell.source for cell in nb.cells if cell.cell_type == "markdown")
    for cell in nbtools.code_cells(nb):
        texts = (output.get("data", {}).get("text/markdown", "") for output in cell.outputs)
        yield from (text for text in texts if text.startswith("*Figure:*"))
