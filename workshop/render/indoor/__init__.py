"""The living room and the training rooms, with their furniture."""
