"""The worked answers of book/answers.md: `python -m workshop answers 03` runs them.

An answer is code that stands at the end of its notebook, what it prints there, and what follows
from it. The notebook runs with the course's solutions first.
"""

import re

import nbformat

from course import kernels, nbtools
from omnistereo_lib.files import write_text

PAGE = nbtools.ROOT / "book" / "answers.md"
ANSWER = re.compile(r"(^### (\d\d\.\d)\n.*?```py\n(.*?)```\n\n```text\n)(.*?)(?=```$)", re.M | re.S)


def codes(number: str) -> dict[str, tuple[str, str]]:
    """Return the answers of a notebook: exercise → its code, what is stored of what it prints."""
    found = ANSWER.findall(PAGE.read_text(encoding="utf-8"))
    return {name: (code, text) for _, name, code, text in found if name.startswith(number)}


def run(number: str) -> dict[str, str]:
    """Run a notebook and the code of its answers; return exercise → what it prints."""
    path = next(path for path in nbtools.notebooks() if nbtools.number(path) == number)
    nb, answers = nbtools.read_notebook(path), codes(number)
    nb.cells += [nbformat.v4.new_code_cell(code) for code, _ in answers.values()]
    kernels.execute(nb, path.parent)
    printed = {}
    for name, cell in zip(answers, nb.cells[-len(answers) :], strict=True):
        texts = [output.text for output in cell.outputs if output.get("name") == "stdout"]
        printed[name] = "".join(texts)
    return printed


def renew(numbers: list[str]) -> None:
    """Run the answers of some notebooks, and store what they print."""
    for number in numbers:
        for name, text in run(number).items():
            page = PAGE.read_text(encoding="utf-8")
            stored = next(found for found in ANSWER.finditer(page) if found[2] == name)
            write_text(PAGE, page[: stored.start(4)] + text + page[stored.end(4) :])
            print(f"{name}\n{text}")
