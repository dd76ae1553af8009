"""What a command writes for people and other programs: the page, pictures, points, meshes, crops,
rigs.
"""
