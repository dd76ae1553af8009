"""The functions that a notebook leaves open: what the student writes, in the flow, and what checks
it.

A module for each notebook, `nb03.py`, holds of each function the right answer, the inputs to try it
on and the usual slips, in `check_look_up = Open(look_up, ...).with_slips(...)`. In the notebook,

    look_up = nb03.check_look_up(look_up)

says what is right or wrong, with a hint from the second failure on, and binds the name to what the
notebook goes on with: the student's function if it is right, the answer if it is not. The notebook
shows the answer's source as the solution.

For grading: `course.exercises.functions("03")` returns all that a notebook leaves open, in order;
each has a `name` and `check(function) -> str`, which is `RIGHT`, begins with `NOT_WRITTEN`, or says
what is wrong.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from course.exercises import beside, mine
from course.exercises.compare import CASES, NOT_WRITTEN, RIGHT, Answer, Array, Rng, diagnose

YOURS_TO_WRITE = "yours to write. Until it is right, the cells below run with the solution."
# Loops over the pixels of the notebooks' functions take 60 to 500 times as long as the solutions,
# other ways to write them at most 5 times; below a quarter of a second nobody waits.
SLOW, NOTICED_S = 20, 0.25

__all__ = ["NOT_WRITTEN", "RIGHT", "Open"]

_GREEN, _RED, _PLAIN = "\x1b[32m", "\x1b[31m", "\x1b[0m"  # as Jupyter and terminals colour text


class Open:
    """A function left open, with its right answer.

    Args:
        answer: The right function. Its source is the solution that the notebook shows.
        draw: Draws the inputs of case number k, a tuple.
        real: Gives the inputs with which the notebook goes on. A function is right only if it is
            right on them, too; if the answer makes a panorama of them, a wrong function's picture
            is shown beside the right one.
        whole: Names of arguments that no example may cut, such as a polynomial.
        keywords: Names of arguments by which the notebook calls it.
        within: By how much a right value may differ, beside four digits: what the method allows.
        order: Sorts what the task leaves in any order.
    """

    def __init__(
        self,
        answer: Answer,
        draw: Callable[[Rng, int], tuple],
        real: Callable[[], tuple] | None = None,
        whole: Sequence[str] = (),
        keywords: Sequence[str] = (),
        within: float = 1e-6,
        order: Callable[[Array], Array] | None = None,
    ) -> None:
        self.within, self.order = within, order
        self.answer, self.draw, self.real, self.whole, self.keywords = (
            answer,
            draw,
            real,
            whole,
            keywords,
        )
        self.name = answer.__name__
        self.source = inspect.getsource(answer).rstrip()
        self.slips: list[tuple[str, str]] = []
        self.solved, self.failures = False, 0  # since the kernel was started

    def with_slips(self, text: str) -> Open:
        """Add the usual slips, at most five: what the student writes, and behind "# " the sentence
        that names it.

        A slip is a change of the answer's source, "what stands there → what the student writes", or
        several on lines of their own, or another body. What shows in the values, such as a sign, a
        mirror or a swapped argument, is recognised without: `course.exercises.kinds`.
        """
        code: list[str] = []
        hint: list[str] = []
        for line in [*textwrap.dedent(text).strip("\n").splitlines(), "the end"]:
            before, mark, after = line.partition("# ")
            if hint and before:
                self.slips.append(("\n".join(code).replace("\n→", " →"), " ".join(hint)))
                code, hint = [], []
            code += [before.rstrip()] if before else []
            hint += [after] if mark else []
        return self

    @cached_property
    def mistaken(self) -> list[tuple[Answer, str]]:
        """The answer with each slip in it, and the slip's hint."""
        return [(changed(self.answer, slip), hint) for slip, hint in self.slips]

    def inputs(self, k: int, seed: int = 0) -> tuple:
        """Draw the inputs of case number k."""
        return self.draw(np.random.default_rng((k, seed)), k)

    def check(self, function: Answer, seed: int = 0) -> str:
        """Try a function on all cases; return `RIGHT`, `NOT_WRITTEN`, or "not yet: " and why."""
        return self.diagnose(function, (self.inputs(k, seed) for k in range(CASES)))

    def diagnose(self, function: Answer, cases: Iterable[tuple]) -> str:
        """Try a function on the inputs of some cases."""
        return diagnose(
            function, self.answer, self.mistaken, cases, self.whole, self.within, self.order
        )

    def __call__(self, function: Answer) -> Answer:
        """Print what `check` says; return the student's function if right, else the answer."""
        if function is self.answer:  # bound by the run before
            print(
                f"{self.name}: this is the solution. To check yours, run its cell again, then"
                " this one."
            )
            return function
        said = self.check(function)
        if said == RIGHT and self.real:
            said = self.diagnose(function, [self.real()])
        if said == RIGHT:
            try:
                inspect.signature(function).bind_partial(**dict.fromkeys(self.keywords))
            except TypeError:
                names = ", ".join(self.keywords)
                said = f"not yet: later cells use the names of its arguments: keep {names}"
        if said.startswith(NOT_WRITTEN):  # as the notebooks are stored
            print(f"{self.name}: {YOURS_TO_WRITE}")
            return self.answer
        if said == RIGHT:
            return self._accept(function)
        self.failures += 1
        hint = f" Hint: {self.hint()}." if self.failures > 1 else ""
        end = "" if said.endswith("\n") else "."
        said = f"{_RED}✗{_PLAIN} {self.name}: {said}{end}{hint}"
        print(f"{said} The notebook goes on with the solution.")
        if self.real:
            beside.show(function, self.answer, self.real())
        return self.answer

    def _accept(self, function: Answer) -> Answer:
        """Say that it is right and keep it; return it, or the answer if it is too slow."""
        self.solved = True
        functions = [
            value
            for value in vars(sys.modules[self.answer.__module__]).values()
            if isinstance(value, Open)
        ]
        count = f"{sum(value.solved for value in functions)} of {len(functions)} in this notebook"
        slow = self.times_slower(function)
        kept = mine.keep(function, self.answer, slow)
        words = f"right, and {slow} times slower than the solution" if slow else "right"
        with_which = "the solution" if slow else "yours"
        print(
            f"{_GREEN}✓{_PLAIN} {self.name}: {words}, {count}{kept and f', {kept}'}. "
            f"The notebook goes on with {with_which}."
        )
        if self.name in mine.needed() and (whole := mine.write_whole()):
            print(f"{whole}.")
        return self.answer if slow else function

    def times_slower(self, function: Answer) -> int:
        """Return how many times the answer's time a right function takes, or 0 if nobody would
        notice.

        Where the notebook's own inputs are known they are timed, else the ten cases together.
        """
        cases = [self.real()] if self.real else [self.inputs(k) for k in range(CASES)]

        def seconds(tried: Answer) -> float:
            started = time.process_time()
            for inputs in cases:
                tried(*inputs)
            return time.process_time() - started

        # The first call may compile, and other programs take time: what seems slow is timed again.
        if (
            seconds(function) < NOTICED_S
            or (taken := min(seconds(function) for _ in range(2))) < NOTICED_S
        ):
            return 0
        times = taken / max(min(seconds(self.answer) for _ in range(3)), 1e-6)
        return round(times) if times >= SLOW else 0

    def hint(self) -> str:
        """Say how the answer begins, without its docstring."""
        tree: Any = ast.parse(self.source)
        first, *others = (node for node in tree.body[0].body if not isinstance(node, ast.Expr))
        return (
            f"a solution begins with `{ast.unparse(first).splitlines()[0]}`"
            if others
            else "one line is enough"
        )


def changed(answer: Answer, slip: str) -> Answer:
    """Return an answer with a slip in it, as `Open.with_slips` has them."""
    source = inspect.getsource(answer)
    if "→" in slip:
        for change in slip.splitlines():
            old, new = map(str.strip, change.split("→"))
            if old not in source:
                raise ValueError(f"{answer.__name__} has no {old!r}")
            source = source.replace(old, new)
    else:
        source = f"{source.splitlines()[0]}\n{textwrap.indent(slip, '    ')}"
    namespace = dict(vars(inspect.getmodule(answer)))
    exec(source, namespace)
    return namespace[answer.__name__]
