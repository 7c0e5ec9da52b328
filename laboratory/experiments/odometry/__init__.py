"""Odometry of recordings on rendered sequences of every kind, and on real ones."""
