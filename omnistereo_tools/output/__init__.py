"""What a command writes for people and other programs: page, pictures, points, meshes."""
