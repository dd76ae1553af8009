"""The progress page: it counts what the checks printed, and ends with the certificate."""

import io
import re
import shutil
from contextlib import redirect_stdout
from functools import partial

import nbformat
import pytest
from nbformat.v4 import new_output

from course import exercises, nbtools
from course.classroom import progress


@pytest.fixture
def copies(tmp_path, monkeypatch):
    """The folder of the working copies."""
    monkeypatch.setattr(progress, "WORKING", tmp_path / "my_notebooks")
    return shutil.copytree(
        nbtools.NOTEBOOKS,
        progress.WORKING,
        ignore=lambda _, names: [n for n in names if not n.endswith("ipynb")],
    )


def answer(path, right):
    """Check some functions of a copy, given whether each is right, and save what is printed."""
    nb = nbformat.read(path, 4)
    for function in exercises.functions(nbtools.number(path)):
        if function.name in right:
            mine = partial(function.answer) if right[function.name] else lambda *inputs: 0.5
            with redirect_stdout(io.StringIO()) as printed:
                function(mine)
            (cell,) = [
                cell for cell in nbtools.code_cells(nb) if f"check_{function.name}(" in cell.source
            ]
            cell.outputs[:1] = [new_output("stream", name="stdout", text=printed.getvalue())]
    nbformat.write(nb, path)


def written(tmp_path):
    progress.write_progress(tmp_path / "out" / "progress.html")
    return (tmp_path / "out" / "progress.html").read_text()


def test_it_counts_what_was_saved(copies, tmp_path, capsys):
    total = sum(len(exercises.functions(nbtools.number(path))) for path in nbtools.notebooks())
    answer(copies / "03_sphere_sweep.ipynb", {"look_up": True, "disagreement": False})
    (copies / "04_zncc.ipynb").unlink()  # never opened
    page = written(tmp_path)
    assert f"<h1>1 of {total} functions are right</h1>" in page and "<figure>" not in page
    assert '<span class="right">✓</span> <code>look_up</code>' in page
    assert '<span class="wrong">✗</span> <code>disagreement</code>' in page
    assert '<span class="">·</span> <code>zncc</code>' in page
    first = re.findall(
        r"Go on with <code>(\w+)</code> in <a href=.http://[^/]+/lab/tree/my_notebooks/(\d\d)_",
        page,
    )
    assert first == [(exercises.functions("00")[0].name, "00")]
    assert "03 Sphere sweep: 1 of 6\n" in capsys.readouterr().out


@pytest.mark.slow
def test_the_certificate_shows_the_panorama_of_the_own_functions_and_nothing_else(copies, tmp_path):
    for path in copies.glob("*.ipynb"):
        answer(
            path, {function.name: True for function in exercises.functions(nbtools.number(path))}
        )
    (picture,) = re.findall(r'base64,([^"]+)"', written(tmp_path))
    nb = nbformat.read(copies / "06_one_page.ipynb", 4)
    (cell,) = [cell for cell in nb.cells if progress.PICTURE in cell.source]
    shown = [output.data for output in cell.outputs if "data" in output]
    assert picture in {data.replace("\n", "") for one in shown for data in one.values()}
    for one in shown:
        one.update(dict.fromkeys(one, '"><script>alert(1)</script>'))
    nbformat.write(nb, copies / "06_one_page.ipynb")
    page = written(tmp_path)
    assert "<figure>" in page and "alert(1)" in page and "<script" not in page
