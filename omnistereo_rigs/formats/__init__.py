"""Rig and camera files of other programs: one module for each family of formats, in and out."""
