"""Checkers for the notebooks' exercises: they try an answer and say what is wrong with it, and what to try next.

A checker runs the answer on ten random cases and compares it with the right one and with what the usual mistakes
would give. It prints its finding and never raises, whatever it is handed.
"""

from course.exercises.cost_arrays import *  # noqa: F403
from course.exercises.depth_arrays import *  # noqa: F403
from course.exercises.geometry import *  # noqa: F403
from course.exercises.lens_arrays import *  # noqa: F403
from course.exercises.matching import *  # noqa: F403
from course.exercises.pipeline import *  # noqa: F403
from course.exercises.results import *  # noqa: F403
from course.exercises.rig_arrays import *  # noqa: F403
from course.exercises.scene_arrays import *  # noqa: F403
from course.exercises.table_arrays import *  # noqa: F403
from course.exercises.volumes import *  # noqa: F403
