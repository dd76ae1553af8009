"""Cameras, poses, rigs, and the spheres swept: only NumPy (paper, Section III-A and III-B)."""
