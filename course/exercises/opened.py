"""The functions that a notebook leaves open: what the student writes, in the flow, and what checks it.

A module for each notebook, `nb03.py`, holds of each function the right answer, the inputs to try it on and the usual
mistakes, in `check_look_up = Open(look_up, ...)`. In the notebook,

    look_up = nb03.check_look_up(look_up)

says in one line what is right or wrong, with a hint from the second failure on, and binds the name to what the notebook
goes on with: the student's function if it is right, the answer if it is not. The notebook shows the answer's source as
the solution.

For grading: `course.exercises.functions("03")` returns all that a notebook leaves open, in order; each has a `name` and
`check(function) -> str`, which is `RIGHT`, begins with `NOT_WRITTEN`, or says what is wrong.
"""

from __future__ import annotations

import ast
import inspect
import sys
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from course.exercises import beside
from course.exercises.compare import CASES, NOT_WRITTEN, RIGHT, Answer, Case, Rng, by, diagnose

__all__ = ["NOT_WRITTEN", "RIGHT", "Open"]

_GREEN, _RED, _PLAIN = "\x1b[32m", "\x1b[31m", "\x1b[0m"  # as Jupyter and terminals colour text


class Open:
    """A function left open, with its right answer.

    Args:
        answer: The right function. Its source is the solution that the notebook shows.
        draw: Draws the inputs of case number k, a tuple.
        mistakes: The usual ones: functions like the answer, each with the sentence that names the mistake.
        picture: Draws inputs of which the answer makes a panorama, (H, W) or (H, W, 3), where seeing it says more than
            the sentence: a wrong function's picture is shown beside the right one.
    """

    def __init__(
        self,
        answer: Answer,
        draw: Callable[[Rng, int], tuple],
        mistakes: Sequence[tuple[Answer, str]],
        picture: Callable[[], tuple] | None = None,
    ) -> None:
        self.answer, self.draw, self.mistakes, self.picture = answer, draw, mistakes, picture
        self.name = answer.__name__
        self.source = inspect.getsource(answer).rstrip()
        self.solved, self.failures = False, 0  # since the kernel was started

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
        if said.startswith(NOT_WRITTEN):  # as the notebooks are stored
            print(f"{self.name}: {NOT_WRITTEN}. The notebook goes on with the solution.")
            return self.answer
        if said == RIGHT:
            self.solved = True
            functions = [
                value for value in vars(sys.modules[self.answer.__module__]).values() if isinstance(value, Open)
            ]
            count = f"{sum(value.solved for value in functions)} of {len(functions)} in this notebook"
            print(f"{_GREEN}✓{_PLAIN} {self.name}: right, {count}. The notebook goes on with yours.")
            return function
        self.failures += 1
        hint = f" Hint: {self.hint()}." if self.failures > 1 else ""
        print(f"{_RED}✗{_PLAIN} {self.name}: {said}.{hint} The notebook goes on with the solution.")
        if self.picture:
            beside.show(function, self.answer, self.picture())
        return self.answer

    def hint(self) -> str:
        """Say how the answer begins, without its docstring."""
        first, *others = (node for node in ast.parse(self.source).body[0].body if not isinstance(node, ast.Expr))
        return f"a solution begins with `{ast.unparse(first).splitlines()[0]}`" if others else "one line is enough"
