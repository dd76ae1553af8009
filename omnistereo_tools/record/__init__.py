"""Depth of a whole recording, frame by frame, on this machine or on many."""
