"""Stereo odometry against a persistent keyframe map."""

from vision_pc.core.odometry.stereo_odometry import StereoOdometry

__all__ = ["StereoOdometry"]
