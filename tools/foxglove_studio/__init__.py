"""Foxglove Studio 1.48, the last of its open line that a registry has, served on loopback over a recording.

A viewer that knows nothing of this project shows whether recordings, layout and live face are what they claim
to be. It is fetched by `make viewer` (needs npm), is not shipped, and asks nobody but this server.
"""
