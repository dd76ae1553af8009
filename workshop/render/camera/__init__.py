"""Lenses, sensors and rigs, each recorded exactly."""
