"""The vision PC's recording: what it saw, measured, asked for and said."""
