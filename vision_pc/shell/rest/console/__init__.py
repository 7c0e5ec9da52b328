"""The operator's console: its page, and the streams of state and pictures that it lives on."""
