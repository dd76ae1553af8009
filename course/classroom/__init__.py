"""For students and teachers: the working copies, the check of the clone, progress, hand-ins and
their judge.
"""
