"""Commands of `omnistereo` that are not the method itself, one module each; they import what is slow when they run."""
