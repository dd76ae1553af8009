"""The functions that the notebooks leave open: right answers, known mistakes, garbage, and where
they are asked for.

The notebooks themselves show that the answers agree with the library, and nbval compares what they
print."""

import ast
import base64
import io
import itertools
import re
from contextlib import redirect_stdout, suppress
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image

from course import exercises, nbtools
from course.classroom import solve
from course.exercises.opened import NOT_WRITTEN, RIGHT, Open

NOTEBOOKS = {nbtools.number(path): nbtools.read_notebook(path) for path in nbtools.notebooks()}
FUNCTIONS = [
    pytest.param(number, function, id=f"{number} {function.name}")
    for number in NOTEBOOKS
    for function in exercises.functions(number)
]
each = pytest.mark.parametrize(("number", "function"), FUNCTIONS)
MOST_LINES = 22


def said(check, function):
    """What a check cell prints, and what the notebook goes on with."""
    with redirect_stdout(io.StringIO()) as printed, patch("IPython.display.display"):
        used = check(function)
    return printed.getvalue(), used


@each
def test_a_check_gives_the_function_to_go_on_with(number, function, monkeypatch):
    monkeypatch.setattr(function, "failures", 0)

    def mine(*inputs, **named):
        return function.answer(*inputs, **named)

    words, used = said(function, mine)
    assert used is mine and f"{function.name}: right, " in words
    wrong, hint = function.mistaken[0]
    for failures in (1, 2):
        with np.errstate(all="ignore"):
            words, used = said(function, wrong)
        assert used is function.answer and f"{function.name}: not yet: {hint}. " in words
        assert ("Hint: " in words) is (failures == 2)
        assert words.endswith(" The notebook goes on with the solution.\n")
    words, used = said(function, function.answer)  # the check cell, run twice
    assert "this is the solution" in words and used is function.answer


# --- In the notebooks


def cells_of(number, function):
    """The cells of an open function: the stub, the check, and the cell after it."""
    cells = NOTEBOOKS[number].cells
    stubs = [
        k for k, c in enumerate(cells) if c.cell_type == "code" and names(c) == [function.name]
    ]
    assert len(stubs) == 1
    return cells[stubs[0] : stubs[0] + 3]


def names(cell):
    return [stub.name for stub in solve.stubs(cell.source)]


@each
def test_a_function_is_asked_for_checked_and_solved_in_one_place(number, function):
    stub, check, solution = cells_of(number, function)
    asked, answer = (ast.parse(source).body[0] for source in (stub.source, function.source))
    assert ast.unparse(asked.args) == ast.unparse(answer.args)
    # a notebook has 120 letters a line, a module 100
    assert ast.get_docstring(asked).split() == ast.get_docstring(answer).split()
    assert ast.unparse(asked.body[-1]) == "..." and len(asked.body) == 2
    assert (
        check.source.splitlines()[0]
        == f"{function.name} = nb{number}.check_{function.name}({function.name})"
    )
    assert nbtools.SOLUTION.match(solution.source)[2] == function.name
    assert f"```python\n{function.source}\n```" in solution.source
    # but for the signature and the docstring
    assert len(ast.unparse(answer).splitlines()) - 2 <= MOST_LINES


@pytest.mark.parametrize("number", NOTEBOOKS)
def test_a_notebook_asks_for_what_its_module_holds(number):
    asked = [name for cell in nbtools.code_cells(NOTEBOOKS[number]) for name in names(cell)]
    functions = [function.name for function in exercises.functions(number)]
    assert not functions or (asked == functions and 3 <= len(functions) <= 7)


@each
def test_a_later_cell_uses_the_function(number, function):
    """So the figures after it could not be drawn without it."""
    cells = nbtools.code_cells(NOTEBOOKS[number])
    check = next(k for k, cell in enumerate(cells) if f"check_{function.name}(" in cell.source)
    later = itertools.chain(*(ast.walk(ast.parse(cell.source)) for cell in cells[check:]))
    uses = sum(isinstance(node, ast.Name) and node.id == function.name for node in later)
    assert uses > 2  # those of the check itself


@pytest.mark.parametrize("number", [number for number in NOTEBOOKS if exercises.functions(number)])
def test_answers_written_into_the_notebook_are_right_there(number):
    """With the notebook's own imports and functions, but for those whose defaults are results."""
    namespace = {}
    nb = solve.solve(NOTEBOOKS[number], solve.open_answers(number))
    for cell in nbtools.code_cells(nb):
        for node in ast.parse(cell.source).body:
            kind = isinstance(node, ast.Import | ast.ImportFrom | ast.FunctionDef)
            if kind or "mine.use(" in ast.unparse(node):
                with suppress(NameError):
                    exec(compile(ast.Module([node], []), "cell", "exec"), namespace)
    for function in exercises.functions(number):
        mine = namespace[function.name]
        assert mine is not function.answer and said(function, mine)[1] is mine


PICTURED = [
    pytest.param(*function.values, id=function.id)
    for function in FUNCTIONS
    if function.values[1].real
    and np.ndim(function.values[1].answer(*function.values[1].real())) > 1
]


@pytest.mark.parametrize(("number", "function"), PICTURED)
def test_a_wrong_picture_is_shown_above_the_right_one(number, function):
    right = np.asarray(function.answer(*function.real()), np.float64)
    assert right.ndim > 1 and np.isfinite(right).mean() > 0.3

    def mirrored(*inputs):
        return function.answer(*inputs)[:, ::-1]

    with redirect_stdout(io.StringIO()), patch("IPython.display.display") as display:
        function(mirrored)
    (shown,), how = display.call_args
    assert how["metadata"]["image/png"]["alt"] == shown["text/plain"]
    assert function.name in shown["text/plain"]
    drawn = np.asarray(
        Image.open(io.BytesIO(base64.b64decode(shown["image/png"]))).convert("L"), np.float64
    )
    yours, beside = (
        half[:, ::-1] if k == 0 else half for k, half in enumerate(np.array_split(drawn, 2))
    )
    middle = np.s_[yours.shape[0] // 3 : -yours.shape[0] // 4, 20:-20]  # without titles and edges
    assert np.corrcoef(yours[middle].ravel(), beside[: len(yours)][middle].ravel())[0, 1] > 0.5


def test_a_wrong_curve_is_shown_beside_the_right_one():
    function = next(check for check in exercises.functions("12") if check.name == "robust_weight")
    with redirect_stdout(io.StringIO()), patch("IPython.display.display") as display:
        function(lambda residuals, scale: function.answer(residuals, scale) ** 2)
    ((shown,), _) = display.call_args
    assert "the values of your robust_weight" in shown["text/plain"]
    drawn = Image.open(io.BytesIO(base64.b64decode(shown["image/png"]))).convert("RGB")
    colors = np.asarray(drawn, int).reshape(-1, 3)
    assert (colors.max(axis=1) < 30).sum() > 300  # the right one, black
    assert ((colors[:, 0] > 180) & (colors[:, 1] < 90)).sum() > 100  # the student's, red


def test_nothing_is_drawn_where_a_picture_says_nothing():
    function = next(check for check in exercises.functions("03") if check.real)
    wrong = [lambda *_: 1 / 0, lambda *_: 0.0, lambda *_: None]
    wrong += [lambda *inputs: function.answer(*inputs) + 1e-4]
    with redirect_stdout(io.StringIO()), patch("IPython.display.display") as display:
        for mistake in wrong:
            function(mistake)
    assert not display.called


def test_a_check_counts_what_is_right_in_its_notebook_and_gives_a_hint(monkeypatch):
    for function in exercises.functions("03"):
        monkeypatch.setattr(function, "solved", False)
        monkeypatch.setattr(function, "failures", 0)
    first, second, *_ = exercises.functions("03")
    for done, function in ((1, first), (2, second), (2, second)):
        words, _ = said(function, lambda *inputs, function=function: function.answer(*inputs))
        assert (
            words == f"\x1b[32m✓\x1b[0m {function.name}: right, {done} of 6 in this notebook. The"
            " notebook goes on with yours.\n"
        )
    begins = "`theta = (columns + 0.5 - width / 2) * 2 * np.pi / width`"
    assert first.hint() == f"a solution begins with {begins}"
    assert exercises.functions("07")[3].hint() == "one line is enough"


# --- Garbage, once


def twice(x, factor):
    return factor * x


CHECK = Open(twice, lambda rng, k: (rng.uniform(1, 2, (2, 3 + k % 2)), 2.0)).with_slips(
    "return x  # multiply"
)


class Hostile:
    """Every way to look at it fails."""

    def __array__(self, *args, **kwargs):
        raise RuntimeError("no array")

    __repr__ = __str__ = __len__ = __iter__ = __float__ = __array__


def overwriting(x, factor):
    x *= factor
    return x


def raising(error):
    def answer(x, factor):
        raise error

    return answer


GARBAGE = {
    "nothing": (lambda x, f: None, NOT_WRITTEN),
    "ellipsis": (lambda x, f: ..., NOT_WRITTEN),
    "not a function": (3, "hand over the function itself"),
    "other arguments": (lambda x: x, "is called with 2 arguments"),
    "an error": (raising(ValueError("no")), "stopped with ValueError: no"),
    "an exit": (raising(SystemExit(1)), "stopped with SystemExit"),
    "text": (lambda x, f: "twice", "expected numbers of shape (2, 3), got str"),
    "hostile": (lambda x, f: Hostile(), "got Hostile"),
    "ragged": (lambda x, f: [[1], [2, 3]], "a list that is no array of numbers"),
    "truth values": (lambda x, f: x > 1, "an array of bool"),
    "too much": (lambda x, f: (f * x, x.shape), "the first thing that you return is right"),
    "wrong shape": (
        lambda x, f: f * x[0],
        "expected numbers of shape (2, 3), got numbers of shape (3,)",
    ),
    "infinite": (
        lambda x, f: np.where(x < 1.5, f * x, np.inf),
        "NaN or infinity where a number is right",
    ),
    "centimetres": (lambda x, f: 100 * f * x, "centimetres"),
    "no name": (lambda x, f: f * x + 0.37, "too large by 0.37 everywhere"),
    "a part": (lambda x, f: f * np.stack([x[0], x[1] ** 2]), "wrong only in number 1 along axis 0"),
    "overwrites": (
        overwriting,
        "the value is right, but your function overwrites its argument number 1",
    ),
    "empty": (lambda x, f: x[:0], "expected numbers of shape (2, 3), got numbers of shape (0, 3)"),
    "single precision": (lambda x, f: (f * x).astype(np.float32), RIGHT),
    "a list": (lambda x, f: (f * x).tolist(), RIGHT),
}


def test_what_is_not_recognised_is_shown_on_the_smallest_example():
    check = Open(twice, lambda rng, k: (rng.uniform(1, 2, (5, 6)), 2.0))
    words = check.check(lambda x, f: np.where(x > 1.6, x**1.5, f * x))
    lines = [line.strip() for line in words.splitlines()]
    assert lines[0] == "not yet: the smallest example that differs:"
    x, yours, right = (float(re.search(r"[\d.]+(?= *\])", line)[0]) for line in lines[1:])
    assert x > 1.6 and right == pytest.approx(2 * x, 1e-4) and yours == pytest.approx(x**1.5, 1e-4)
    assert "factor = 2" in lines[1] and len(lines) == 4


def test_an_error_comes_with_the_line_of_the_student():
    def wrong(x, factor):
        y = x.sum(axis=0)
        return factor * y[7, 7]

    assert re.search(
        r"stopped with IndexError: .*, in line \d+ of its cell: `return factor \* y\[7, 7\]`$",
        CHECK.check(wrong),
    )


def test_the_next_cell_has_the_last_word(monkeypatch):
    """A function that is right on the cases is called on what the notebook goes on with, too."""
    monkeypatch.setattr(CHECK, "real", lambda: (np.arange(6.0).reshape(2, 3), 3.0))
    words, used = said(CHECK, lambda x, factor: 2 * x)
    assert used is twice and "if `factor` were smaller by 1" in words


def test_a_name_that_a_later_cell_uses_is_kept():
    check = Open(twice, CHECK.draw, keywords=["factor"])
    words, used = said(check, lambda x, f: f * x)
    assert used is twice
    assert words.startswith("\x1b[31m✗\x1b[0m twice: not yet: later cells use the names")


@pytest.mark.parametrize("name", GARBAGE)
def test_garbage_gets_a_sentence(name):
    function, words = GARBAGE[name]
    assert words in CHECK.check(function)


@pytest.mark.parametrize("error", [KeyboardInterrupt, GeneratorExit])
def test_an_interrupt_is_not_swallowed(error):
    with pytest.raises(error):
        CHECK.check(raising(error()))
