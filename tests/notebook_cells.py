"""Small notebooks, and nbval on them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import notebook_comparison
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from course import nbtools

SETUP = "# needs omnistereo_lib, course\n" + nbtools.SETUP
FACTS = {"title": "Tiny", "learn": "nothing", "needs": "CPU", "minutes_to_read": 1, "budget_s": 60}
DRAWING = """import matplotlib.pyplot as plt
from course.figures.plot import show

fig, ax = plt.subplots(figsize=(2, 1))
ax.plot([0, 1])
show(fig, "04 one ray")
"""
SLIDER = """from ipywidgets import interact

@interact(n=(0, 9))
def picture(n=3):
    print("n is", n)
    return n
"""
OPENING = "# Tiny\n\n**You will** see.\n\n**Before you start:** nothing. **Next:** nothing."
CLOSING = """## Exercises

**00.1 (warm-up).** Look.

**00.2 (open).** Look again.

## Common errors

## Takeaways

## Further reading"""


def code(source, *tags, printed=None, count=1):
    """A code cell, stored with what it is said to have printed."""
    outputs = (
        [] if printed is None else [nbformat.v4.new_output("stream", name="stdout", text=printed)]
    )
    return new_code_cell(
        source, metadata={"tags": list(tags)}, outputs=outputs, execution_count=count
    )


def notebook(*cells, **metadata):
    return new_notebook(cells=list(cells), metadata={"omnistereo": FACTS} | metadata)


def write(path, nb):
    nbformat.write(nb, path)
    return path


def framed(*cells):
    """Cells between the texts with which every notebook opens and closes."""
    return notebook(new_markdown_cell(OPENING), *cells, new_markdown_cell(CLOSING))


def nbval(path):
    """Run nbval as `make test` does, with our comparison: for each cell, did it pass?"""
    shutil.copy(Path(notebook_comparison.__file__), path.parent / "conftest.py")
    sanitize = nbtools.ROOT / "tests" / "nbval_sanitize.cfg"
    options = ["--nbval", "--nbval-current-env", f"--nbval-sanitize-with={sanitize}"]
    options += ["-rA", "--color=no"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "-p", "no:cacheprovider", path.name],
        cwd=path.parent,
        capture_output=True,
        text=True,
        env={key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")},
    )
    said = re.findall(rf"^(PASSED|FAILED) {path.name}::Cell (\d+)", done.stdout, re.MULTILINE)
    verdicts = {int(number): verdict == "PASSED" for verdict, number in said}
    assert verdicts, done.stdout + done.stderr
    return [verdicts[number] for number in range(len(verdicts))]
