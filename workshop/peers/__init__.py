"""How other programs see lenses, poses and our files: measured in environments of their own, for
book/conventions.md.

    python -m workshop.peers [NAME ...]     measures all, or some, and says what has changed
"""
