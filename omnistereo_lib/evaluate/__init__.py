"""The paper's table on any data: `methods` what is compared, `strata` on which rays, `run` how, `table` the outcome."""

from omnistereo_lib.evaluate.methods import ABLATIONS, METHODS, select_methods
from omnistereo_lib.evaluate.run import SCALES, Evaluation, Scale, evaluate_frame, find_sets
from omnistereo_lib.evaluate.table import Table, errors_table, strata_table, write_results

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
    "select_methods",
    "strata_table",
    "write_results",
]
