"""The functions that a notebook leaves open: what the student writes, in the flow, and what checks it.

A module for each notebook, `nb03.py`, holds of each function the right answer, the inputs to try it on and the usual
mistakes, in `check_look_up = Open(look_up, ...)`. In the notebook,

    look_up = nb03.check_look_up(look_up)

says in one line what is right or wrong, and binds the name to what the notebook goes on with: the student's function
if it is right, the answer if it is not. The notebook shows the answer's source as the solution.

For grading: `course.exercises.functions("03")` returns all that a notebook leaves open, in order; each has a `name` and
`check(function) -> str`, which is `RIGHT`, begins with `NOT_WRITTEN`, or says what is wrong.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from course.exercises.compare import CASES, NOT_WRITTEN, RIGHT, Answer, Case, Rng, by, diagnose

__all__ = ["NOT_WRITTEN", "RIGHT", "Open"]


class Open:
    """A function left open, with its right answer.

    Args:
        answer: The right function. Its source is the solution that the notebook shows.
        draw: Draws the inputs of case number k, a tuple.
        mistakes: The usual ones: functions like the answer, each with the sentence that names the mistake.
    """

    def __init__(
        self, answer: Answer, draw: Callable[[Rng, int], tuple], mistakes: Sequence[tuple[Answer, str]]
    ) -> None:
        self.answer, self.draw, self.mistakes = answer, draw, mistakes
        self.name = answer.__name__
        self.source = inspect.getsource(answer).rstrip()

    def case(self, k: int, seed: int = 0) -> Case:
        """Draw case number k: inputs, right value, and what each mistake gives instead."""
        inputs = self.draw(np.random.default_rng((k, seed)), k)
        with np.errstate(all="ignore"), warnings.catch_warnings():  # mistakes divide by zero
            warnings.simplefilter("ignore", RuntimeWarning)
            return by(inputs, self.answer, self.mistakes)

    def check(self, function: Answer) -> str:
        """Try a function on all cases; return `RIGHT`, `NOT_WRITTEN` and what to do, or "not yet: " and why."""
        return diagnose(function, map(self.case, range(CASES)))

    def __call__(self, function: Answer) -> Answer:
        """Print what `check` says of the student's function; return it if it is right, and the answer if it is not."""
        if function is self.answer:  # bound by the run before
            print(f"{self.name}: this is the solution. To check yours, run its cell again, then this one.")
            return function
        said = self.check(function)
        said = NOT_WRITTEN if said.startswith(NOT_WRITTEN) else said
        right = said == RIGHT
        print(f"{self.name}: {said}. The notebook goes on with {'yours' if right else 'the solution'}.")
        return function if right else self.answer
