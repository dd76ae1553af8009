"""Every function × every slip that students have made (slips.txt): it is refused, and in words that
help. Answers that no checker was written for (held_out.txt): right ones by another way are
accepted, wrong ones that look right are not.
"""

from pathlib import Path

import numpy as np
import pytest

from course import exercises, nbtools
from course.exercises.compare import RIGHT, numbers
from course.exercises.opened import Open, changed

OPENED = {f.name: f for nb in nbtools.notebooks() for f in exercises.functions(nbtools.number(nb))}
each = pytest.mark.parametrize("function", OPENED.values(), ids=OPENED)


def table(name):
    """Yield what stands in a file beside this one, a function each, as parameters of a test."""
    function, text = None, {}
    for line in Path(__file__).with_name(name).read_text("utf-8").splitlines():
        if line in OPENED:
            function = line
        elif not line.startswith("# "):
            text[function] = text.get(function, "") + line + "\n"
    for name, lines in text.items():
        rows = Open(OPENED[name].answer, OPENED[name].draw).with_slips(lines).slips
        for k, row in enumerate(rows):
            yield pytest.param(OPENED[name], *row, id=f"{name} {k}")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("function", "slip", "words"), list(table("slips.txt")))
def test_a_slip_that_was_met_is_refused_with_words_that_help(function, slip, words):
    said = function.check(changed(function.answer, slip))
    assert words in said and said != RIGHT


@each
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_usual_slips_are_named(function):
    assert len(function.slips) <= 5
    for slip, hint in function.mistaken:
        assert function.check(slip) == f"not yet: {hint}"


KINDS = [
    (lambda x: -x, "other sign"),
    (lambda x: 2 * x, "twice the right value"),
    (np.degrees, "180/π times"),
    (lambda x: x + 1, "too large by 1"),
    (lambda x: x[::-1], "mirrored|swapped|reversed"),
    (lambda x: np.roll(x, 1, -1), "shifted by one|swapped"),
    (lambda x: x.T, "transposed"),
    (lambda x: np.nan_to_num(x, posinf=0), "0 where"),
]


@each
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_kinds_of_slips_are_recognised(function):
    named = {RIGHT, *(f"not yet: {hint}" for _, hint in function.slips)}
    for change, words in KINDS:

        def slipped(*inputs, change=change):
            right = numbers(function.answer(*inputs))
            return change(right) if right.ndim else change(right[None])[0]

        said = function.check(slipped)
        assert said in named or any(
            word in said for word in ("the value is right", *words.split("|"))
        ), words


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("function", "answer", "verdict"), list(table("held_out.txt")))
def test_what_is_right_is_accepted_and_what_is_wrong_is_not(function, answer, verdict):
    own = changed(function.answer, answer)
    with np.errstate(all="ignore"):
        said = function.check(own)
        if said == RIGHT and function.real:
            said = function.diagnose(own, [function.real()])
    assert (said == RIGHT) == verdict.startswith("right"), said
