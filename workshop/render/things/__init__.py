"""Training scenes of many things at all distances."""
