"""Calibration programs: orientation adjustment, line equation, trajectory matching, local error model."""
