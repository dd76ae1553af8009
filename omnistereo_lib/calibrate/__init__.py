"""Calibration: from pictures of a checkerboard to a rig that can be trusted (paper, Section III-A).

In the order in which a calibration runs: `board` and `detect` (corners in pictures), `start` (a first camera out of
nothing), `bundle` (the least-squares problem), `camera` and `rig` (`calibrate_camera`, `calibrate_rig`), `report`.
"""
