"""Fast code for one device each: what `reference` defines, with the same numbers. Only `stereo`
comes here.
"""
