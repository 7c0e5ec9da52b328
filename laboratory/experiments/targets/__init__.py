"""Targets without markers against the truth: drawn walls, drawn machines, rows of holes."""
