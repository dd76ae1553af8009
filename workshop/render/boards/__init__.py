"""The calibration captures: where the board is, the studio around it, the files."""
