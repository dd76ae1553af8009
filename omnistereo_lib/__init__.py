"""Omnidirectional stereo: four fisheye images in, one 360° depth panorama out.

The names below are the library's face. They are loaded on first use (PEP 562), so that importing the
package is quick and Blender's interpreter, which has no torch, can use the geometry.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_NAMES = {
    "errors": ["OmnistereoError"],
    "rig_files": ["OcamCamera", "Rig", "load_rig"],
    "geometry.camera": ["fit_inverse_polynomial"],
    "geometry.pose": ["Pose"],
    "geometry.rig": ["camera_pairs"],
    "geometry.sphere": ["SphereGrid"],
    "calibrate.board": ["Checkerboard"],
    "calibrate.camera": ["calibrate_camera"],
    "calibrate.rig": ["calibrate_rig"],
    "stereo.sweep": ["SphereSweep"],
    "stereo.zncc": ["ZNCC"],
    "stereo.mccnn": ["MCCNN"],
    "stereo.sweepnet": ["SweepNet"],
    "stereo.volumenet": ["VolumeNet"],
    "stereo.learned": ["LearnedCost"],
    "stereo.volume": ["cost_volume"],
    "stereo.sgm": ["sgm"],
    "stereo.depth": ["winner_takes_all", "confidence", "Depth"],
    "stereo.metrics": ["index_error", "sparsification"],
    "dataset": ["load_dataset", "load_images"],
    "stereo.methods": ["Method"],
    "stereo.pipeline": ["estimate_depth"],
}
_EXPORTS = {name: module for module, names in _NAMES.items() for name in names}

__all__ = list(_EXPORTS)


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_EXPORTS[name]}"), name)
    globals()[name] = value  # found directly from now on
    return value


def __dir__() -> list[str]:
    return __all__


class _LazyPackage(ModuleType):
    """The package as a module whose function `sgm` is not replaced by the module of that name.

    Python binds every imported submodule to its package, so that `osl.sgm` would be the function or the module
    depending on what was imported before.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _EXPORTS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _LazyPackage
