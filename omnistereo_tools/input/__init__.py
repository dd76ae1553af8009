"""What a command reads: recordings, masks, image circles, and the nearest depth where nobody states it."""
