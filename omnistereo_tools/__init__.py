"""Applications of `omnistereo_lib`: the command line `omnistereo`, and the modules that its
commands use.
"""
