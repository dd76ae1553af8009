"""For whoever changes a notebook or the book: run, check and store them; website, slides,
README.
"""
