"""The table of the paper on any data: `methods`, `regions` of rays, `run` and resume, `table`."""

from omnistereo_learn.evaluate.methods import ABLATIONS, METHODS, select_methods
from omnistereo_learn.evaluate.run import SCALES, Evaluation, Scale, evaluate_frame, find_sets
from omnistereo_learn.evaluate.table import Table, errors_table, regions_table, write_results

__all__ = [
    "ABLATIONS",
    "METHODS",
    "SCALES",
    "Evaluation",
    "Scale",
    "Table",
    "errors_table",
    "evaluate_frame",
    "find_sets",
    "regions_table",
    "select_methods",
    "write_results",
]
