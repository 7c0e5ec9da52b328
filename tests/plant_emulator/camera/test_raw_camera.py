"""A camera that nobody rectified: plates are painted whole although their sides are bent, and as OpenCV has
it.
"""

import cv2
import numpy as np

from tests.plant_emulator.camera.camera_world import CLEAN, camera, start_view
from tests.plant_emulator.camera.corner_oracle import project_corners

RAW = {
    "lens": {"fx_px": 533.4, "fy_px": 532.7, "cx_px": 651.6, "cy_px": 348.3, "k1": -0.12, "k2": 0.02,
             "p1": 0.0004, "p2": -0.0003, "k3": 0.0},
    "lens_difference": {"fx_px": 2.1, "fy_px": 1.6, "cx_px": -14.2, "cy_px": 7.4, "k1": 0.006, "k2": -0.002},
    "rectification": {"right_eye_rotation_deg": [0.31, -0.46, 0.17]},
}  # fmt: skip


def test_markers_lie_where_opencv_projects_them_in_both_raw_eyes() -> None:
    eyes = camera(CLEAN | {"camera": CLEAN["camera"] | RAW})
    view = start_view(eyes.scene)
    pair = eyes.render(view.X_WC, view.X_WM, 1)
    exact = project_corners(eyes, view.X_WC, view.X_WM)
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000))
    for k, picture in enumerate(pair):
        found, numbers, _ = detector.detectMarkers(picture)
        assert {0, 1, 3} <= set(numbers.ravel().tolist())  # the tool hides a part of marker 2
        for corners, number in zip(found, numbers.ravel().tolist(), strict=True):
            np.testing.assert_allclose(corners[0], exact[number][k], atol=1.5)  # unrefined; bent by tens


def test_a_plate_is_painted_as_far_as_its_bent_sides_reach() -> None:
    """A plate over most of the picture: its sides bulge beyond the box of its corners by many pixels."""
    board = {
        "kind": "checkerboard",
        "columns": 8,
        "rows": 5,
        "square_m": 0.16,
        "position_m": [0.0, 0.0, 0.01],
    }
    eyes = camera(CLEAN | {"camera": CLEAN["camera"] | RAW, "boards": [board]})
    view = start_view(eyes.scene)
    X_WO = eyes.scene.mounts.X_WO
    facing = X_WO @ np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.9], [0, 0, 0, 1.0]])
    picture = eyes.render(facing, view.X_WM, 1)[0]
    half = np.array([5.4 * 0.16, 3.9 * 0.16])  # within the white rim
    along = np.linspace(-1.0, 1.0, 41)
    top = np.stack([along * half[0], np.full(41, half[1]), np.full(41, 0.01)], axis=1)
    seen = eyes.project(facing, top @ X_WO[:3, :3].T + X_WO[:3, 3])[0]
    corners = seen[[0, -1], 1].min()
    inside = (seen[:, 0] > 4) & (seen[:, 0] < 1275) & (seen[:, 1] > 4) & (seen[:, 1] < 715)
    assert corners - seen[inside, 1].min() > 10.0  # the side does bulge
    for u, v in seen[inside].round().astype(int):
        assert picture[v, u] > 150
