"""Rig and camera files of other programs, in and out: a table of dialects, OpenCV, COLMAP."""
