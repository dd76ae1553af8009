"""Rigs from images without a board: who has pictures but no checkerboard comes here."""
