"""Depth out of the library and into use: pictures, a viewer, meshes, recordings, ONNX, a live view, checks of rigs.

Installed beside `omnistereo_lib` and built on it; only the command line of the library imports from here.
"""
