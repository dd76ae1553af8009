"""For whoever changes a notebook or the book: website, slides, README."""
