"""Omnidirectional stereo: four fisheye images in, one 360° depth panorama out.

The names below are the library's face. They are loaded on first use (PEP 562), so that importing the
package is quick and Blender's interpreter, which has no torch, can use the geometry.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_EXPORTS = {
    "OmnistereoError": "errors",
    "OcamCamera": "rig_files",
    "fit_inverse_polynomial": "geometry.camera",
    "Pose": "geometry.pose",
    "Rig": "rig_files",
    "load_rig": "rig_files",
    "camera_pairs": "geometry.rig",
    "SphereGrid": "geometry.sphere",
    "Checkerboard": "calibrate.board",
    "calibrate_camera": "calibrate.camera",
    "calibrate_rig": "calibrate.rig",
    "SphereSweep": "stereo.sweep",
    "ZNCC": "stereo.zncc",
    "MCCNN": "stereo.mccnn",
    "SweepNet": "stereo.sweepnet",
    "VolumeNet": "stereo.volumenet",
    "LearnedCost": "stereo.learned",
    "cost_volume": "stereo.volume",
    "sgm": "stereo.sgm",
    "winner_takes_all": "stereo.depth",
    "confidence": "stereo.depth",
    "Depth": "stereo.depth",
    "index_error": "stereo.metrics",
    "sparsification": "stereo.metrics",
    "load_dataset": "dataset",
    "load_images": "dataset",
    "Method": "stereo.methods",
    "estimate_depth": "stereo.pipeline",
    "doctor": "doctor",
}

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
    """The package as a module whose functions `sgm` and `doctor` are not replaced by the modules of those names.

    Python binds every imported submodule to its package, so that `osl.sgm` would be the function or the module
    depending on what was imported before.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _EXPORTS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _LazyPackage
