"""Rig and camera files: every format that is read or written, one module a family.

`Rig.load`, `Rig.save` and `OcamCamera.load` are attached here, so that `geometry` knows nothing of files.
"""

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.dialects import load_rig, read_ocam_txt, save_rig

__all__ = ["OcamCamera", "Rig", "load_rig", "read_ocam_txt", "save_rig"]

Rig.load, Rig.save, OcamCamera.load = staticmethod(load_rig), save_rig, staticmethod(read_ocam_txt)
