"""Numbers of odometry that hold for every camera and every world: no user sets them."""

GRID_COLUMNS, GRID_ROWS = 24, 14  # [D] cells of a picture, each with one point at most
MINIMUM_COVERAGE = 0.06  # [D] share of the grid's cells with a tracked point
MINIMUM_INLIERS = 25  # [D]
PATCH_PX = 21  # [M] side of the patches matched to sub-pixels
RANSAC_PX = 2.0  # [D]
ROW_ERROR_PX = 2.0  # [D] epipolar error before refinement; rectification leaves 0.2
HUBER_PX = 0.3  # [M] about three times the tracker's noise
NOISE_PX = HUBER_PX / 3.0
"""Standard deviation of one tracked coordinate that the robust weights go with."""
