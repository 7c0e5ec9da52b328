"""An independent sub-pixel corner estimator for pictures without noise: edge positions by area, then lines.

The sum of the grey levels across an edge gives its position exactly when pixels integrate light over their
area, whatever the point spread; no gradient, no interpolation, nothing shared with the renderer.
"""

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.camera.stereo_camera import StereoCamera

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]


def refined_corners(picture: Grey, predicted: Matrix, half_window: int, end_gap: float) -> Matrix | None:
    """Corners (4, 2) px found near ``predicted`` (4, 2); None where an edge cannot be followed.

    ``half_window`` pixels on either side of an edge must be of one colour each; ``end_gap`` pixels at both
    ends of an edge are left out.
    """
    lines = []
    for k in range(4):
        line = _edge_line(picture, predicted[k], predicted[(k + 1) % 4], half_window, end_gap)
        if line is None:
            return None
        lines.append(line)
    return np.array([_crossing(lines[k - 1], lines[k]) for k in range(4)])


def _edge_line(picture: Grey, a: Matrix, b: Matrix, half_window: int, end_gap: float) -> Matrix | None:
    """Line n·x = c as (nx, ny, c) fitted to the edge from a to b."""
    steep = abs(b[1] - a[1]) > abs(b[0] - a[0])
    image = picture if steep else picture.T
    (u0, v0), (u1, v1) = (a, b) if steep else (a[::-1], b[::-1])
    low, high = int(np.ceil(min(v0, v1) + end_gap)), int(np.floor(max(v0, v1) - end_gap))
    points = []
    for v in range(low, high + 1):
        centre = round(u0 + (u1 - u0) * (v - v0) / (v1 - v0))
        left, right = centre - half_window, centre + half_window + 1
        if not (0 <= v < image.shape[0] and left >= 0 and right <= image.shape[1]):
            return None
        profile = image[v, left:right].astype(np.float64)
        first, last = profile[:2].mean(), profile[-2:].mean()
        if abs(last - first) < 50.0:
            return None
        points.append((left - 0.5 + ((profile - last) / (first - last)).sum(), v))
    if len(points) < 8:
        return None
    u, v = np.array(points).T
    slope, offset = np.polyfit(v, u, 1)
    return np.array([1.0, -slope, offset]) if steep else np.array([-slope, 1.0, offset])


def _crossing(first: Matrix, second: Matrix) -> Matrix:
    return np.linalg.solve(np.array([first[:2], second[:2]]), np.array([first[2], second[2]]))


def project_corners(
    eyes: StereoCamera, X_WC: Matrix, X_WM: Matrix, X_WO: Matrix | None = None
) -> dict[int, tuple[Matrix, Matrix]]:
    """Marker id → its four printed corners in (left, right), (4, 2) px each, in ArUco's order.

    ``X_WO``: None where the scene has it.
    """
    parents = {"O": eyes.scene.mounts.X_WO if X_WO is None else X_WO, "M": X_WM}
    return {
        marker: eyes.project(X_WC, corners @ parents[parent][:3, :3].T + parents[parent][:3, 3])
        for marker, (parent, corners) in eyes.scene.marker_corners().items()
    }
