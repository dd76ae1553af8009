"""The notebooks' own tests are tested: what deviates must be found, and only that."""

import nbformat
import pytest
from nbformat.v4 import new_markdown_cell
from notebook_cells import FACTS, SETUP, SLIDER, code, framed, nbval, notebook, write

from course import nbtools, rules
from course.figures.captions import captions
from workshop import __main__


def test_a_kernel_that_has_died_is_not_waited_for(tmp_path):
    path = write(tmp_path / "dies.ipynb", notebook(code("import os; os._exit(1)"), code("1")))
    assert nbval(path) == [False, False]


# --- The comparison, one nbval run over all cases

CASES = {  # code, tags, what is stored, whether the two agree
    "same": ("print('rms 0.1234 px')", (), "rms 0.1234 px\n", True),
    "drift within 0.1 %": ("print('rms 0.12341 px')", (), "rms 0.12342 px\n", True),
    "drift beyond 0.1 %": ("print('rms 0.1234 px')", (), "rms 0.1244 px\n", False),
    "number without blank": ("print('12.34%')", (), "12.35%\n", True),
    "sign": ("print(-0.5)", (), "0.5\n", False),
    "changed word": ("print('mean 0.1234 px')", (), "rms 0.1234 px\n", False),
    "changed unit": ("print('rms 0.1234 px')", (), "rms 0.1234 m\n", False),
    "changed integer": ("print(100000)", (), "100001\n", False),
    "changed shape": ("(1, 2)", (), None, False),
    "one number more": ("print(0.5, 0.5)", (), "0.5\n", False),
    "version is a name": ("print('v 2.1000.0')", (), "v 2.1001.0\n", False),
    "digits of a name": ("print('float32')", (), "float64\n", False),
    "width follows value": ("print(f'{10.0001:8.4f}|')", (), "  9.9999|\n", True),
    "exponent": ("print('1.0000e-05')", (), "1.0001e-05\n", True),
    "exponent differs": ("print('1.0000e-05')", (), "1.0000e-06\n", False),
    "nan is no number": ("print('nan')", (), "0.5\n", False),
    "rtol tag, within": ("print(0.500)", ("rtol-1e-2",), "0.504\n", True),
    "rtol tag, beyond": ("print(0.500)", ("rtol-1e-2",), "0.510\n", False),
    "atol tag, within": ("print(1.1)", ("atol-0.5",), "1.5\n", True),
    "atol tag, beyond": ("print(1.1)", ("atol-0.5",), "1.7\n", False),
    "atol tag leaves integers": ("print(1)", ("atol-2",), "2\n", False),
    "address and duration": (
        "print('at 0x7f0011223344 in 1.5 s')",
        (),
        "at 0x7f0055667788 in 2.5 s\n",
        True,
    ),
    "output lost": ("pass", (), "0.5\n", False),
    "output not stored": ("print(0.5)", (), None, False),
    "a warning now": ("import warnings\nwarnings.warn('old')", (), None, True),
    "an exception": ("1 / 0", (), None, False),
    "slider": (SLIDER, (), None, True),
    "slider that fails": (SLIDER.replace("return n", "1 / 0"), (), None, False),
}


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory):
    cells = [code(source, *tags, printed=printed) for source, tags, printed, _ in CASES.values()]
    found = nbval(write(tmp_path_factory.mktemp("cases") / "cases.ipynb", notebook(*cells)))
    return dict(zip(CASES, found, strict=True))


@pytest.mark.parametrize("case", CASES)
def test_comparison(verdicts, case):
    assert verdicts[case] is CASES[case][-1]


# --- Clean, check


def good(*more):
    """A notebook as it should be stored, with some more cells."""
    return framed(code(SETUP, printed="OK\n"), *more)


def closing(old, new):
    """A good notebook but for a change in its last text."""
    nb = good()
    assert old in nb.cells[-1].source
    nb.cells[-1].source = nb.cells[-1].source.replace(old, new)
    return nb


def stored(nb):
    return nbtools.text_of(nbtools.clean(nb))


def picture(alt="a line that rises from left to right", plain=None, caption="*Figure:* It rises."):
    cell = code("draw()", count=2)
    data = {"image/png": "iVBORw0KGgo=", "text/plain": alt if plain is None else plain}
    cell.outputs = [
        nbformat.v4.new_output("display_data", data=data, metadata={"image/png": {"alt": alt}})
    ]
    if caption:
        cell.outputs.append(nbformat.v4.new_output("display_data", data={"text/markdown": caption}))
    return cell


def with_output(kind, source="f()", **content):
    cell = code(source, count=2)
    cell.outputs = [nbformat.v4.new_output(kind, **content)]
    return cell


ERROR = {"ename": "ValueError", "evalue": "no"}
ERROR |= {"traceback": ["File /Users/someone/x.py", "ValueError: no"]}
BAD = {  # what is planted, what the guard must say
    "not run": (good(code("f()", count=None)), "not run in order"),
    "run twice": (good(code("f()", count=3)), "not run in order"),
    "stripped": (framed(code(SETUP)), "no cell has an output"),
    "no setup": (framed(code("import os", printed="OK\n")), "first code cell"),
    "no facts": (good() | {"metadata": {}}, "metadata.omnistereo"),
    "budget": (good() | {"metadata": {"omnistereo": FACTS | {"budget_s": 600}}}, "budget_s is 600"),
    "error": (good(with_output("error", **ERROR)), "ValueError, without the tag"),
    "stderr": (good(with_output("stream", name="stderr", text="old")), "a warning"),
    "svg": (good(with_output("display_data", data={"image/svg+xml": "<svg/>"})), "an SVG"),
    "address": (
        good(with_output("execute_result", data={"text/plain": "<B at 0x7f3a5c>"})),
        "memory address",
    ),
    "path": (
        good(code("f()", printed="in /Users/someone/x.py\n", count=2)),
        "path of this machine",
    ),
    "progress": (good(code("f()", printed="1 %\r2 %\n", count=2)), "progress bar"),
    "semicolon": (good(code("f();", count=2)), "ends in ';'"),
    "long cell": (
        good(code("f()", count=2), code("f()\n" * 31, count=3)),
        "a code cell of 31 lines",
    ),
    "long cells": (good(*(code("f()\n" * 11, count=n) for n in (2, 3))), "11 lines in the median"),
    "long": (good(*(code("f()\n" * 8, count=n) for n in range(2, 54))), "lines of code in all"),
    "size": (good(code("f()", printed="x" * 800_000, count=2)), "at most 800"),
    "no alt": (good(picture(alt="")), "without alternative text"),
    "alt elsewhere": (good(picture(plain="<Figure size 640x480>")), "without alternative text"),
    "no caption": (good(picture(caption=None)), "without a caption"),
    "markdown picture": (good(new_markdown_cell("![](rig.png)")), "picture in the text"),
    "html picture": (good(new_markdown_cell('<img src="rig.png">')), "picture in the text"),
    "no opening": (good() | {"cells": good().cells[1:]}, "its first text"),
    "no section": (closing("## Common errors", "**Common errors.**"), "its last sections"),
    "other order": (
        closing("## Takeaways\n\n## Further reading", "## Further reading\n\n## Takeaways"),
        "its last sections",
    ),
    "section too many": (
        closing("## Further reading", "## Further reading\n\n## More"),
        "its last sections",
    ),
    "unmarked exercise": (closing("00.2 (open)", "00.2"), "its exercises"),
    "unknown mark": (closing("(open)", "(Open)"), "its exercises"),
    "nothing open": (closing("(open)", "(hard)"), "its exercises"),
    "hard first": (closing("**00.1", "**00.0 (open).** Look.\n\n**00.1"), "its exercises"),
}


@pytest.mark.parametrize("case", BAD)
def test_guard_finds(case):
    nb, said = BAD[case]
    found = rules.problems(stored(nbformat.from_dict(nb)))
    assert len(found) == 1 and said in found[0]


def test_guard_is_content_with_a_good_notebook():
    failing = with_output("error", **ERROR)
    failing.metadata["tags"] = ["raises-exception"]
    failing.execution_count = 3
    described = new_markdown_cell('![the rig](rig.png) <img src="rig.png" alt="the rig">')
    assert rules.problems(stored(good(picture(), failing, described))) == []


@pytest.mark.parametrize("command", ["run", "clean", "lint", "stills"])
@pytest.mark.parametrize(
    ("name", "said"), [("nix.ipynb", "cannot be read: No such file"), ("a.md", "is not a notebook")]
)
def test_what_is_no_notebook_is_one_line(tmp_path, capsys, command, name, said):
    (tmp_path / "a.md").write_text("# Tiny\n", encoding="utf-8")
    assert __main__.main([command, str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {tmp_path / name} {said}")
    assert (tmp_path / "a.md").read_text(encoding="utf-8") == "# Tiny\n"


def test_guard_finds_what_clean_would_drop(tmp_path):
    nb = nbtools.clean(good())
    nb.metadata["widgets"] = {"application/vnd.jupyter.widget-state+json": {}}
    path = write(tmp_path / "tiny.ipynb", nb)
    (found,) = rules.problems(nbtools.read_text(path))
    assert "not clean" in found
    assert __main__.main(["clean", str(path)]) == 0
    assert rules.problems(nbtools.read_text(path)) == []


def test_clean_drops_what_depends_on_the_machine_and_keeps_the_rest():
    view = {nbtools.WIDGET: {"model_id": "abc"}, "text/plain": "interactive()"}
    slider = with_output("display_data", data=view)
    cell = code("1 / 0", "raises-exception", "rtol-1e-2", count=7)
    cell.metadata |= {"execution": {"iopub.execute_input": "2026"}, "colab": {}, "collapsed": False}
    cell.outputs = [nbformat.v4.new_output("error", **ERROR)]
    kernel = {"name": "my-env", "display_name": "mine"}
    language = {"name": "python", "version": "3.12.1"}
    nb = notebook(cell, slider, kernelspec=kernel, language_info=language, widgets={}, colab={})
    clean = nbtools.clean(nb)
    assert clean.metadata.omnistereo == FACTS
    assert set(clean.metadata) == {"kernelspec", "language_info", "omnistereo"}
    assert clean.metadata.kernelspec.name == "python3"
    assert "version" not in clean.metadata.language_info
    assert [cell.id for cell in clean.cells] == ["cell-0", "cell-1"]
    assert clean.cells[0].metadata == {"tags": ["raises-exception", "rtol-1e-2"]}
    # a count is what happened: only a new run changes it
    assert clean.cells[0].execution_count == 7
    assert clean.cells[0].outputs[0].traceback == ["ValueError: no"]
    assert clean.cells[1].outputs == []
    assert nbtools.clean(clean) == clean
    nbformat.validate(clean)


def test_a_new_caption_needs_no_run():
    stale = picture(caption="*Figure:* the old one")
    stale.source = 'show(fig, "04 one ray")'
    (cell,) = nbtools.clean(notebook(stale)).cells
    entry = captions()["04 one ray"]
    shown = cell.outputs[0]
    assert shown.data["text/plain"] == shown.metadata["image/png"]["alt"] == entry["alt"]
    assert cell.outputs[1].data["text/markdown"] == f"*Figure:* {entry['caption']}"
