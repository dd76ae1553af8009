"""How does a network learn to match, and how good is it?

`recipes` (settings), `loop` (training), `samples` (what a network is shown, and what its loss
compares), `endless` (worlds that are drawn on the fly), `evaluate` (the paper's table on any data).
The public names are listed in `__init__.pyi`; each is imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
