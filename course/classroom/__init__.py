"""For students and teachers: working copies, a check of the clone, progress, hand-ins."""
