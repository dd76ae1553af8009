from .methods import ABLATIONS as ABLATIONS
from .methods import METHODS as METHODS
from .methods import select_methods as select_methods
from .run import SCALES as SCALES
from .run import Evaluation as Evaluation
from .run import Scale as Scale
from .run import evaluate_frame as evaluate_frame
from .run import find_sets as find_sets
from .table import Table as Table
from .table import errors_table as errors_table
from .table import regions_table as regions_table
from .table import write_results as write_results

__all__: list[str]
