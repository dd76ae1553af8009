"""The exercises' checkers against students: right ones, each usual mistake, and garbage."""

import math
import sys
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import students_geometry
import students_matching
import students_pipeline
import students_results
import students_volumes
import torch

from course import exercises
from course.exercises import diagnose

CHECKERS = [value for name, value in vars(exercises).items() if name.startswith("check_")]
MODULES = students_geometry, students_matching, students_pipeline, students_results, students_volumes
ANSWERS = {name: value for module in MODULES for name, value in vars(module).items()}
STUDENTS = {check: ANSWERS[check.__name__.removeprefix("check_").upper()] for check in CHECKERS}
ALL_STUDENTS = [(check, words, answer) for check, students in STUDENTS.items() for words, answer in students]


def task(check, monkeypatch):
    """The inputs, the right value and the mistakes of a checker."""
    seen = []
    with monkeypatch.context() as patch:
        patch.setattr(sys.modules[check.__module__], "diagnose", lambda answer, *rest: seen.append(rest))
        check(None)
    return seen[0]


@pytest.mark.parametrize(("check", "words", "answer"), ALL_STUDENTS)
def test_student_is_told_what_is_wrong(check, words, answer, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert said == "right\n" if words == "right" else words in said and said.startswith("not yet: ")


def test_every_checker_has_two_right_students():
    assert all([words for words, _ in students].count("right") >= 2 for students in STUDENTS.values())


@pytest.mark.parametrize("check", CHECKERS)
def test_every_hint_is_heard_by_a_student(check, monkeypatch):
    inputs, right, mistakes = task(check, monkeypatch)
    heard = {diagnose(answer, inputs, right, mistakes) for _, answer in STUDENTS[check]}
    assert {f"not yet: {hint}" for _, hint in mistakes} <= heard


@pytest.mark.parametrize("check", CHECKERS)
def test_right_value_and_mistakes_differ_by_more_than_single_precision(check, monkeypatch):
    _, right, mistakes = task(check, monkeypatch)
    assert np.isfinite(right).all()
    for one, other in combinations([right, *(value for value, _ in mistakes)], 2):
        assert np.shape(one) != np.shape(other) or not np.allclose(one, other, rtol=5e-4, atol=5e-6, equal_nan=True)


@pytest.mark.parametrize("check", CHECKERS)
def test_inputs_of_another_call_are_untouched(check, monkeypatch):
    """A student who overwrites the arguments changes neither the inputs nor what is compared."""
    inputs, right, mistakes = task(check, monkeypatch)
    before = [np.array(value) for value in inputs if isinstance(value, np.ndarray)]

    def overwrite(*arguments):
        for array in arguments:
            if isinstance(array, np.ndarray):
                array[...] = -7
        return right

    assert diagnose(overwrite, inputs, right, mistakes) == "right"
    for array, copy in zip([value for value in inputs if isinstance(value, np.ndarray)], before, strict=True):
        np.testing.assert_array_equal(array, copy)


# Garbage: what it is, and what the checker must tell to do next.


class Hostile:
    """Every way to look at it fails."""

    def __array__(self, *args, **kwargs):
        raise RuntimeError("no array")

    def __repr__(self):
        raise RuntimeError("no repr")

    __str__ = __len__ = __iter__ = __float__ = __eq__ = __repr__
    __hash__ = object.__hash__


class MuteError(Exception):
    """An exception that cannot be printed."""

    def __str__(self):
        raise ValueError("no text")


def raiser(error):
    def answer(*_):
        raise error

    return answer


def endless(*arguments):
    return endless(*arguments)


def generator(*_):
    yield 1.0


ragged_loop = []
ragged_loop.append(ragged_loop)

RETURNED = {
    "none": (None, "replace the ..."),
    "ellipsis": (..., "replace the ..."),
    "string": ("abc", "got str. Return real numbers"),
    "string of a number": ("1.5", "got str. Return real numbers"),
    "strings": (["1", "2"], "got a list that is no array of numbers. Return real numbers"),
    "bytes": (b"1", "got bytes. Return real numbers"),
    "truth value": (True, "got bool. Return real numbers"),
    "truth values": (np.ones(2, bool), "got an array of bool. Return real numbers"),
    "complex": (1 + 2j, "got complex. Return real numbers"),
    "complex array": (np.ones(3) * 1j, "got an array of complex128. Return real numbers"),
    "object": (object(), "got object. Return real numbers"),
    "hostile object": (Hostile(), "got Hostile. Return real numbers"),
    "objects": (np.array([None, 1]), "got an array of object. Return real numbers"),
    "fraction": (Fraction(1, 3), "got Fraction. Return real numbers"),
    "date": (np.datetime64("2019-05-20"), "got datetime64. Return real numbers"),
    "dict": ({"a": 1}, "got dict. Return real numbers"),
    "set": ({1.0}, "got set. Return real numbers"),
    "function": (abs, "got builtin_function_or_method. Return real numbers"),
    "generator": ((x for x in (1.0, 2.0)), "got generator. Return real numbers"),
    "None inside": ([None, 1.0], "got a list that is no array of numbers. Return real numbers"),
    "ellipsis inside": ([..., ...], "got a list that is no array of numbers. Return real numbers"),
    "ragged": ([[1.0, 2.0], [3.0]], "got a list that is no array of numbers. Return real numbers"),
    "list in itself": (ragged_loop, "got a list that is no array of numbers. Return real numbers"),
    "tuple of different things": (
        (np.zeros(2), "seen"),
        "got a tuple that is no array of numbers. Return real numbers",
    ),
    "tensor with a gradient": (torch.ones(3, requires_grad=True), "got Tensor. Return real numbers"),
    "wrong shape": (np.zeros((3, 5, 7)), "of shape (3, 5, 7). Look at the axes"),
    "empty": ([], "of shape (0,). Look at the axes"),
    "empty tuple": ((), "of shape (0,). Look at the axes"),
}
CALLED = {
    "exception": (raiser(KeyError("D_min")), "stopped with KeyError: 'D_min'. Call it"),
    "unprintable exception": (raiser(MuteError()), "Call it with numbers of your own"),
    "assertion": (raiser(AssertionError()), "stopped with AssertionError. Call it"),
    "TypeError inside": (lambda *_: ... + 1, "stopped with TypeError: unsupported"),
    "exit": (raiser(SystemExit(1)), "stopped with SystemExit: 1. Call it"),
    "endless recursion": (endless, "stopped with RecursionError"),
    "no arguments": (lambda: 1.0, "arguments: keep its first line as it was"),
    "too many arguments": (lambda a, b, c, d, e, f, g: 1.0, "arguments: keep its first line as it was"),
    "generator function": (generator, "got generator. Return real numbers"),
    "class": (Hostile, "keep its first line as it was"),
    "called already": (2.5, "hand over the function itself"),
    "nothing": (None, "hand over the function itself"),
    "text": ("depth", "hand over the function itself"),
}
GARBAGE = [
    *(pytest.param(lambda *_, it=value: it, words, id=name) for name, (value, words) in RETURNED.items()),
    *(pytest.param(answer, words, id=name) for name, (answer, words) in CALLED.items()),
]


@pytest.mark.parametrize("check", CHECKERS)
@pytest.mark.parametrize(("answer", "words"), GARBAGE)
def test_garbage_gets_the_next_thing_to_try(check, answer, words, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert words in said and said.count("\n") == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("check", CHECKERS)
def test_not_finite(check, bad, monkeypatch):
    inputs, right, _ = task(check, monkeypatch)
    found = np.array(right, np.float64)
    found[(0,) * found.ndim] = bad
    assert "Look for a division by zero" in diagnose(lambda *_: found, inputs, right, [])


@pytest.mark.parametrize("check", CHECKERS)
def test_unknown_mistake(check, monkeypatch):
    inputs, right, mistakes = task(check, monkeypatch)
    said = diagnose(lambda *_: np.asarray(right) * 1.37, inputs, right, mistakes)
    worst = float(said.split("off by up to ")[1].split(",")[0])
    assert worst == pytest.approx(0.37 * np.abs(right).max(), rel=0.01)
    assert said.endswith("Work out one value by hand and compare")


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (-1, "other sign"),
        (2, "twice"),
        (0.5, "half"),
        (100, "100 times"),
        (0.01, "hundredth"),
        (math.degrees(1), "are there degrees"),
        (math.radians(1), "are there radians"),
    ],
)
def test_common_factor(factor, words):
    right = np.array([1.5, 0.0, -3.0])
    assert words in diagnose(lambda x: x * np.float32(factor), (right,), right, [])


@pytest.mark.parametrize("error", [KeyboardInterrupt, GeneratorExit])
def test_interrupt_is_not_swallowed(error):
    with pytest.raises(error):
        exercises.check_parabola(raiser(error()))


def test_what_a_student_prints_stays_and_the_finding_comes_last(capsys):
    def talkative(left, middle, right):
        print("left is", left)
        return students_matching.vertex_of_fit(left, middle, right)

    exercises.check_parabola(talkative)
    assert capsys.readouterr().out == "left is 0.5\nright\n"
