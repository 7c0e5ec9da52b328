"""A stereo camera put into service: its pairs checked, its calibration made."""
