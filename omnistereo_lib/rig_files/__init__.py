"""Rig and camera files: one module for each family of formats, reading and writing."""

from omnistereo_lib.rig_files.formats import load_camera, load_rig
from omnistereo_lib.rig_files.ocam import save_rig

__all__ = ["load_camera", "load_rig", "save_rig"]
