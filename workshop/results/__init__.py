"""For whoever checks our figures: speed, ablations, uncertainty, the stored results and weights."""
