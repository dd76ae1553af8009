"""The checkers of the exercises that are not in the flow yet, against students: right ones, each usual mistake."""

import copy
import functools
from itertools import combinations

import numpy as np
import pytest
import students_volumes

from course import exercises
from course.exercises.compare import CASES, diagnose

CHECKERS = [value for name, value in vars(exercises).items() if name.startswith("check_")]
MODULES = (students_volumes,)
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
