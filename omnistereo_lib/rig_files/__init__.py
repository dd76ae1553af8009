"""Rig and camera files: one module for each family of formats, reading and writing.

`Rig.load`, `Rig.save` and `OcamCamera.load` are attached here, so that `geometry` does not depend on files.
"""

from omnistereo_lib.geometry.camera import OcamCamera
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.rig_files.formats import load_rig
from omnistereo_lib.rig_files.ocam import read_ocam_txt
from omnistereo_lib.rig_files.omnimvs import save_rig

__all__ = ["OcamCamera", "Rig", "load_rig", "read_ocam_txt", "save_rig"]

Rig.load, Rig.save, OcamCamera.load = staticmethod(load_rig), save_rig, staticmethod(read_ocam_txt)
