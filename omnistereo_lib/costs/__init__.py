"""Matching costs, one module each; every one is called like `ZNCC`."""
