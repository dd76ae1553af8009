"""What students write, and the checks that say what is wrong with it: a module for each notebook,
such as nb03.

A check runs the student's function on ten random cases and compares it with the right answer and
with what the usual mistakes would give. It prints its finding and never raises, whatever it is
handed.
"""

from importlib import import_module
from pathlib import Path

from course.exercises.opened import Open


def functions(notebook: str) -> list[Open]:
    """Return the functions that a notebook, such as "03", leaves open, in its order."""
    name = f"nb{notebook}"
    if not Path(__file__).with_name(f"{name}.py").is_file():
        return []
    return [
        value
        for value in vars(import_module(f"{__name__}.{name}")).values()
        if isinstance(value, Open)
    ]
