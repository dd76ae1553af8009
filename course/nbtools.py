"""Read, clean and write notebook files. Cleaned, they are the same whoever ran them."""

import copy
import re
import symtable
from itertools import pairwise
from pathlib import Path

import nbformat

from course import exercises
from course.exercises.opened import Open
from course.figures.captions import caption_output, captions
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import read_bytes, write_text

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = ROOT / "notebooks"

SETUP = (
    "import omnistereo_lib as osl\nfrom course.classroom.doctor import doctor\n\ndoctor(short=True)"
)
PACKAGES = ["omnistereo_lib", "omnistereo_rigs", "omnistereo_learn", "omnistereo_tools"]
PACKAGES += ["course", "workshop"]
IMPORT = re.compile(r"^(?:from|import) (\w+)", re.MULTILINE)
# The folded solution of an open function; clean() writes the right answer's source into it.
SOLUTION = re.compile(
    r"(<details><summary>A solution: <code>(\w+)</code></summary>\n\n```python\n)(.*?)(?=\n```)",
    re.DOTALL,
)

# names that notebooks had once; their pages in the book lead on
MOVED = {
    "05_mccnn": "07_mccnn",
    "06_sweepnet": "08_sweepnet",
    "06b_what_sweepnet_knows": "09_what_sweepnet_knows",
    "07_sgm": "05_sgm",
    "08_evaluation": "10_evaluation",
    "09_your_own_rig": "11_your_own_rig",
    "10_render_a_city": "13_ray_caster",
    "11_gallery": "15_gallery",
    "12_after_sweepnet": "16_after_sweepnet",
    "13_one_page": "06_one_page",
    "14_the_pictures_know_the_rig": "12_the_pictures_know_the_rig",
    "15_one_world": "17_one_world",
}
PICTURES = ("image/png", "image/jpeg")
WIDGET = "application/vnd.jupyter.widget-view+json"


def notebooks() -> list[Path]:
    """Return the paths of all notebooks of the course, in the order in which they are read."""
    return sorted(NOTEBOOKS.glob("*.ipynb"))


def number(path: Path) -> str:
    """Return the number of a notebook, such as "06"."""
    return path.name.partition("_")[0]


def code_cells(nb: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return the code cells that are not empty."""
    return [cell for cell in nb.cells if cell.cell_type == "code" and cell.source.strip()]


def drawing_cells(nb: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    """Return the cells that only draw: no check, and nothing that a later cell needs."""
    found, needed = [], set[str]()
    for cell in reversed(code_cells(nb)):
        top = symtable.symtable(cell.source, "", "exec")
        scopes = [top]
        for scope in scopes:
            scopes.extend(scope.get_children())
        bound = {name.get_name() for name in top.get_symbols() if name.is_assigned()}
        if "show(" in cell.source and "check_" not in cell.source and not bound & needed:
            found.append(cell)
        read = {
            name.get_name()
            for scope in scopes
            for name in scope.get_symbols()
            if name.is_referenced() and (scope is top or name.is_global())
        }
        needed = (needed | read) - bound
    return found[::-1]


def setup_of(nb: nbformat.NotebookNode) -> str:
    """Return the first code cell of a notebook: a line with the packages it needs, and `SETUP`."""
    imported = {name for cell in code_cells(nb) for name in IMPORT.findall(cell.source)}
    imported |= set(IMPORT.findall(SETUP))
    return f"# needs {', '.join(name for name in PACKAGES if name in imported)}\n{SETUP}"


def read_text(path: Path) -> str:
    """Return the text of a notebook file; an `OmnistereoError` if it is not a notebook."""
    content = read_bytes(path)
    try:
        # what tools use
        _ = [cell.cell_type + cell.source for cell in nbformat.reads(content, as_version=4).cells]
        return content.decode()
    except Exception as error:  # JSON, its keys, a format of the future: nbformat raises many kinds
        kind = type(error).__name__
        raise OmnistereoError(
            f"{path} is not a notebook ({kind}): save it again in JupyterLab"
        ) from None


def read_notebook(path: Path) -> nbformat.NotebookNode:
    """Return a notebook; an `OmnistereoError` if it is not one."""
    return nbformat.reads(read_text(path), as_version=4)


def clean(nb: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a notebook without what depends on the machine and the program that ran it; fill in
    its solutions, and fold cells that only draw, in JupyterLab, too.

    Tags, outputs, execution counts and code stay as they are, but for the first cell.
    """
    nb = copy.deepcopy(nb)
    facts = nb.metadata.get("omnistereo", {})
    nb.metadata = nbformat.from_dict(
        {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {
                "name": "python",
                "file_extension": ".py",
                "mimetype": "text/x-python",
            },
            "omnistereo": facts,
        }
    )
    nb.nbformat, nb.nbformat_minor = 4, 5
    answers = {function.name: function.source for function in open_functions(nb)}
    first = next(iter(code_cells(nb)), None)
    if first and first.source.endswith(SETUP):
        first.source = setup_of(nb)
    drawing = drawing_cells(nb)
    for number, cell in enumerate(nb.cells):
        cell.id = f"cell-{number}"
        if cell.cell_type == "markdown":
            cell.source = SOLUTION.sub(
                lambda fold: fold[1] + answers.get(fold[2], fold[3]), cell.source
            )
        kept = {"tags": tags} if (tags := cell.metadata.get("tags")) else {}
        folded = {"jupyter": {"source_hidden": True}} if cell in drawing else {}
        cell.metadata = nbformat.from_dict(kept | folded)
        if cell.cell_type == "code":
            # A widget without its kernel shows nothing; the figure beside it is what a reader sees.
            cell.outputs = [one for one in cell.outputs if WIDGET not in one.get("data", {})]
            for output in cell.outputs:
                if output.output_type == "error":  # the frames name files of this machine
                    output.traceback = [f"{output.ename}: {output.evalue}"]
            _renew_captions(cell)
    return nb


def open_functions(nb: nbformat.NotebookNode) -> list[Open]:
    """Return the functions that a notebook leaves open, from the module that its checks name."""
    named = re.search(r"\bnb(\d\d)\.check_", "\n".join(cell.source for cell in code_cells(nb)))
    return exercises.functions(named[1]) if named else []


def _renew_captions(cell: nbformat.NotebookNode) -> None:
    """Write captions and alternative texts of captions.yaml into the outputs, without a run."""
    names = iter(re.findall(r'\bshow\(.*, "([^"]+)"\)', cell.source))
    for picture, below in pairwise(cell.outputs):
        mime = next((mime for mime in PICTURES if mime in picture.get("data", {})), None)
        if (
            mime
            and "text/markdown" in below.get("data", {})
            and (entry := captions().get(next(names, "")))
        ):
            picture.data["text/plain"] = picture.metadata[mime]["alt"] = entry["alt"]
            below.data = nbformat.from_dict(caption_output(entry["caption"]))


def text_of(nb: nbformat.NotebookNode) -> str:
    """Return the notebook as the text of its file."""
    return nbformat.writes(nb).rstrip("\n") + "\n"


def clean_stored(paths: list[Path]) -> None:
    """Clean the files of notebooks."""
    for path in paths:
        write_text(path, text_of(clean(read_notebook(path))))
