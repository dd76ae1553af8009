"""The command line `omnistereo`, and the modules that its commands use."""
