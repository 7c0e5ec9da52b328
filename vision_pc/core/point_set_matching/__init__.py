"""Matching of two pose trajectories: coarse frame alignment, then the hybrid mixture model."""
