"""Calibration: from images of boards to a rig with known uncertainty (paper, Section III-A).

In the order of a calibration: `captures` (files), `board`, `detect` (corners), `init` (initial
estimate), `params` and `bundle` (the least-squares problem), `solution`, `single_camera` and
`joint` (`calibrate_camera`, `calibrate_rig`), `report`.
"""
