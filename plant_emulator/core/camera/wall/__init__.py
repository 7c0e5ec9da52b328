"""The wall: its texture, its painter, and the holes drilled into it."""
