from .evaluate.run import evaluate_frame as evaluate_frame
from .loop import train as train
from .recipes import RECIPES as RECIPES

__all__: list[str]
