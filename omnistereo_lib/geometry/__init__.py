"""Cameras, poses, rigs and the spheres that are swept: only NumPy (paper, Section III-A and
III-B).
"""
