"""Why a pair with texture gives no points: rows that do not fit, or eyes the wrong way round."""

import numpy as np

from vision_pc.config.vision import OdometrySettings
from vision_pc.core.odometry import tracking
from vision_pc.core.odometry.frame import Frame
from vision_pc.core.se3 import Array

_MOST = 0.8
_WINDOW_PX = 31  # wider than odometry's own: nothing is known of where to look


def fault(frame: Frame, settings: OdometrySettings) -> str:
    """``bad_rectification: …``, ``swapped_eyes: …`` with what was found, else ``no_texture``."""
    left, right = frame.pair.left, frame.pair.right
    pixels = tracking.features(left, frame.left_static, np.zeros((0, 2)), settings)
    if len(pixels) < settings.minimum_inliers:
        return "no_texture"
    wide = settings.model_copy(update={"window_px": _WINDOW_PX, "pyramid_levels": 6})
    found = tracking.track(left, right, pixels, pixels.copy(), wide)
    if int(found.good.sum()) < settings.minimum_inliers:
        return "no_texture"
    moved: Array = found.points[found.good] - pixels[found.good]
    rows, columns = np.median(moved, axis=0)[::-1]
    spread = 1.4826 * float(np.median(np.abs(moved[:, 1] - rows)))
    if abs(rows) > max(settings.row_error_px, spread):  # matches in noise spread wider than they are off
        return (
            f"bad_rectification: right rows {rows:+.1f} px off, spread {spread:.1f} px, {len(moved)} points"
        )
    backwards = int((moved[:, 0] > settings.least_disparity_px).sum())
    if columns > 0.0 and backwards > _MOST * len(moved):
        return f"swapped_eyes: {backwards} of {len(moved)} points farther right in the right picture"
    return "no_texture"
