"""Where do the cameras stand? From boards, from ordinary images, from other programs' files.

Who has cameras but no rig file comes here; who has a rig that does not fit, to `doctor`. The public
names are listed in `__init__.pyi`; each is imported on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
