"""The exercises' checkers against students: right ones, each usual mistake, and garbage."""

import copy
import functools
import math
import re
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
from course.exercises.compare import CASES, diagnose

CHECKERS = [value for name, value in vars(exercises).items() if name.startswith("check_")]
MODULES = students_geometry, students_matching, students_pipeline, students_results, students_volumes
ANSWERS = {name: value for module in MODULES for name, value in vars(module).items()}
# Checkers of functions on arrays keep their wrong implementations beside them; their right student is the solution.
NAMES = {check: check.__name__.removeprefix("check_").upper() for check in CHECKERS}
STUDENTS = {check: ANSWERS[name] for check, name in NAMES.items() if name in ANSWERS}
ALL_STUDENTS = [(check, words, answer) for check, students in STUDENTS.items() for words, answer in students]


@functools.cache
def cases(check):
    return [check.case(k) for k in range(CASES)]


def replay(values):
    """A student whose function returns these values, one after the other."""
    values = iter(values)
    return lambda *_: next(values)


@pytest.mark.parametrize(("check", "words", "answer"), ALL_STUDENTS)
def test_student_is_told_what_is_wrong(check, words, answer, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert said == "right\n" if words == "right" else words in said and said.startswith("not yet: ")


def test_every_checker_has_two_right_students():
    assert all([words for words, _ in students].count("right") >= 2 for students in STUDENTS.values())


@pytest.mark.parametrize("check", CHECKERS)
def test_every_mistake_is_told_by_its_hint(check):
    for tasks in zip(*(mistakes for _, _, mistakes in cases(check)), strict=True):
        assert len({hint for _, hint in tasks}) == 1
        assert diagnose(replay(value for value, _ in tasks), cases(check)) == f"not yet: {tasks[0][1]}"


@pytest.mark.parametrize("check", CHECKERS)
def test_right_value_and_mistakes_differ_by_more_than_single_precision(check):
    given = cases(check)
    rows = [[right, *(value for value, _ in mistakes)] for _, right, mistakes in given]
    for one, other in combinations(zip(*rows, strict=True), 2):
        assert any(
            np.shape(a) != np.shape(b) or not np.allclose(a, b, rtol=5e-4, atol=5e-6, equal_nan=True)
            for a, b in zip(one, other, strict=True)
        )


@pytest.mark.parametrize("check", CHECKERS)
def test_cases_are_the_same_each_time_and_differ(check):
    first, again = ([repr(check.case(k)[0]) for k in range(CASES)] for _ in range(2))
    assert first == again or any("object at" in inputs for inputs in first)
    assert len(set(first)) > CASES / 2


def overwrite(arrays):
    for array in arrays:
        if isinstance(array, np.ndarray):
            array[...] = 7 if array.dtype == np.uint8 else -7


@pytest.mark.parametrize("check", CHECKERS)
def test_a_student_who_overwrites_the_inputs_is_told(check):
    given = cases(check)
    before = copy.deepcopy([inputs for inputs, _, _ in given])
    rights = iter([right for _, right, _ in given])

    def answer(*arguments):
        overwrite(arguments)
        return next(rights)

    arrays = any(isinstance(value, np.ndarray) for value in before[0])
    assert ("overwrites its argument number" if arrays else "right") in diagnose(answer, given)
    for (inputs, _, _), copies in zip(given, before, strict=True):
        for now, copied in zip(inputs, copies, strict=True):
            if isinstance(now, np.ndarray):
                np.testing.assert_array_equal(now, copied)


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
KINDS = [exercises.check_parabola, exercises.check_pixel_of_point, exercises.check_blend]  # number, vector, image
GARBAGE = [
    *(pytest.param(lambda *_, it=value: it, words, id=name) for name, (value, words) in RETURNED.items()),
    *(pytest.param(answer, words, id=name) for name, (answer, words) in CALLED.items()),
]


@pytest.mark.parametrize("check", KINDS)
@pytest.mark.parametrize(("answer", "words"), GARBAGE)
def test_garbage_gets_the_next_thing_to_try(check, answer, words, capsys):
    check(answer)
    said = capsys.readouterr().out
    assert words in said and said.count("\n") == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("check", CHECKERS)
def test_not_finite(check, bad):
    inputs, right, _ = check.case(0)
    found = np.array(right, np.float64)
    found[tuple(np.argwhere(np.isfinite(found))[0])] = bad
    assert "Look for a division by zero" in diagnose(lambda *_: found, [(inputs, right, [])])


@pytest.mark.parametrize("check", CHECKERS)
def test_unknown_mistake(check):
    given = [(inputs, np.asarray(right, np.float64), []) for inputs, right, _ in cases(check)]
    said = diagnose(replay(right * 1.37 for _, right, _ in given), given)
    worst = float(said.split("off by up to ")[1].split(" ")[0])
    assert worst in [pytest.approx(0.37 * np.nanmax(np.abs(right)), rel=0.01) for _, right, _ in given]
    assert said.endswith("Work out one value by hand and compare")


def test_the_first_difference_is_told():
    right = np.arange(6.0).reshape(2, 3)
    found = np.array([[0, 1, 2], [3, 4.25, 6]])
    assert "4.25 at [1, 1] where 4 is right, and off by up to 1 in all" in diagnose(lambda: found, [((), right, [])])


def test_a_number_where_nan_is_right():
    said = diagnose(lambda: [1.0, 2.0], [((), [1.0, np.nan], [])])
    assert "2 at [1] where nan is right" in said


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
    assert words in diagnose(lambda x: x * np.float32(factor), [((right,), right, [])])


@pytest.mark.parametrize("error", [KeyboardInterrupt, GeneratorExit])
def test_interrupt_is_not_swallowed(error):
    with pytest.raises(error):
        exercises.check_parabola(raiser(error()))


def test_what_a_student_prints_stays_and_the_finding_comes_last(capsys):
    def talkative(left, middle, right):
        print("left is", left)
        return students_matching.vertex_of_fit(left, middle, right)

    exercises.check_parabola(talkative)
    assert re.fullmatch(rf"(left is [\d.]+\n){{{CASES}}}right\n", capsys.readouterr().out)
