"""Rig and camera files: one module for each family of formats, reading and writing."""

from omnistereo_lib.rig_file import save_rig
from omnistereo_rigs.formats.read import load_camera, load_rig

__all__ = ["load_camera", "load_rig", "save_rig"]
