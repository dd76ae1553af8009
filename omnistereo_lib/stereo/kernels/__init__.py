"""Fast code for one device each, with the numbers of `reference`. Only `stereo` comes here."""
