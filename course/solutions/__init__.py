"""The solutions of the notebooks' exercises: one function for each stub, with its name and its arguments.

`python -m course solve` puts them in the place of the stubs. They use what every notebook has imported, numpy
as np, and are written as on a board: one step a line, the reason beside it.
"""
