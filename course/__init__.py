"""The machinery of the course: exercises, figures, the reproduction report, tools for notebooks and
the book.
"""
