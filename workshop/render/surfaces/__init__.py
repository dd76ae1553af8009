"""What things are made of and how they are lit: shaders, materials, patterns, lights, meshes."""
