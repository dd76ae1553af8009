"""Fast code for the CPU, with the numbers of `reference`. Only `stereo` comes here."""
