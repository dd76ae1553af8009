"""What a command reads: recordings, and masks."""
