"""Omnidirectional stereo: four fisheye images in, one 360° depth panorama out.

Start with `reference`: it is the whole method in one file, which the rest only makes faster.

The public names are listed in `__init__.pyi`. Each is imported on first use, so that `import
omnistereo_lib` is quick and Blender's interpreter, which has no torch, can use the geometry.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
