"""Solutions with one thing changed: if that changes a result on other cases, no checker may call it
right.

A checker tries ten cases. Here thirty more are drawn, so a change that those ten cannot tell from
the solution is a hole in the checker. Some changes of each solution are tried, the same each time;
`MUTANTS=all` tries them all."""

import ast
import copy
import inspect
import os
import random
import warnings

import numpy as np
import pytest

from course import exercises, nbtools
from course.exercises.compare import CASES, numbers, same

TRIED = None if os.environ.get("MUTANTS") == "all" else 4
EXERCISES = [
    pytest.param(function, function.answer, id=f"{nbtools.number(path)} {function.name}")
    for path in nbtools.notebooks()
    for function in exercises.functions(nbtools.number(path))
]

OPERATORS = """Add Sub, Sub Add, Mult Div Add, Div Mult FloorDiv, FloorDiv Div, Mod Div, Pow
Mult, MatMult Mult, BitAnd BitOr, BitOr BitAnd, Lt LtE Gt, LtE Lt Gt, Gt GtE Lt, GtE Gt Lt, Eq
NotEq, NotEq Eq"""
OTHERS = {
    getattr(ast, first): [getattr(ast, op) for op in ops]
    for first, *ops in map(str.split, OPERATORS.split(","))
}
NAMES = """min max, minimum maximum, argmin argmax, nanmin nanmax, sum mean, nansum nanmean,
nanmean mean, nansum sum, nanmin min, nanargmin argmin, floor rint, floor ceil, sin cos, hypot
add, isnan isfinite, ones zeros, radians degrees, any all, cumsum cumprod"""
PAIRS = [tuple(pair.split()) for pair in NAMES.split(",")]
PAIRS += [pair[::-1] for pair in PAIRS]


def changes(node):
    """Yield what could stand in the place of a node of the syntax tree."""
    if isinstance(node, ast.BinOp):
        yield from (ast.BinOp(node.left, op(), node.right) for op in OTHERS.get(type(node.op), []))
        yield from (node.left, node.right, ast.BinOp(node.right, node.op, node.left))
    elif isinstance(node, ast.Compare):
        for op in OTHERS.get(type(node.ops[0]), []):
            yield ast.Compare(node.left, [op(), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield from (
            ast.Constant(value)
            for value in (node.value + 1, node.value - 1, 2 * node.value)
            if value >= 0
        )
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Attribute):
        yield from (
            ast.Attribute(node.value, other, node.ctx) for one, other in PAIRS if one == node.attr
        )
    elif isinstance(node, ast.Call):
        yield from node.args[:1]  # abs(x), np.clip(x, …), np.sqrt(x): x
        yield from (ast.Call(node.func, node.args, []) for _ in node.keywords[:1])
        if len(node.args) == 2:
            yield ast.Call(node.func, node.args[::-1], node.keywords)
    elif isinstance(node, ast.Slice):
        yield ast.Slice(None, None, None)


def mutants(function):
    """Yield a function and its source for each thing that can be changed in it."""
    tree = ast.parse(inspect.getsource(function))
    size = len(list(ast.walk(tree)))
    for place in range(size):
        for number in range(len(list(changes(list(ast.walk(tree))[place])))):
            mutant = copy.deepcopy(tree)
            old = list(ast.walk(mutant))[place]
            new = list(changes(old))[number]
            for parent in ast.walk(mutant):
                for name, value in ast.iter_fields(parent):
                    if value is old:
                        setattr(parent, name, new)
                    elif isinstance(value, list):
                        setattr(parent, name, [new if one is old else one for one in value])
            source = ast.unparse(mutant)
            if source != ast.unparse(tree):
                yield source


def value_of(function, inputs):
    try:
        return numbers(function(*copy.deepcopy(inputs)))
    except Exception:
        return None


@pytest.mark.parametrize(("check", "answer"), EXERCISES)
def test_no_mutant_is_called_right(check, answer):
    sources = sorted(set(mutants(answer)))
    if TRIED:
        sources = random.Random(0).sample(sources, min(TRIED, len(sources)))
    assert sources
    others = [check.inputs(k, seed) for seed in range(1, 4) for k in range(CASES)]
    for source in sources:
        namespace = dict(vars(inspect.getmodule(answer)))
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            exec(source, namespace)
            mutant = namespace[answer.__name__]
            if check.check(mutant) != "right":
                continue
            for inputs in others:
                found = value_of(mutant, inputs)
                assert found is not None and same(found, value_of(answer, inputs)), (
                    f"called right, differs on {inputs}:\n{source}"
                )
