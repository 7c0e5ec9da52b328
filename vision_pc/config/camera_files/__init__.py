"""Calibration files of stereo cameras: our own, and those of others."""
