"""For whoever draws in a notebook: captioned panels, line drawings, meshes."""
