"""Time and truth of a rendered pair, beside the usual way: OpenCV's warpPerspective of painted textures."""

import time

import cv2
import numpy as np
import pytest

from plant_emulator.core.camera.scene import Plate
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from plant_emulator.core.camera.wall.wall_texture import SIZE, wall_texture
from tests.plant_emulator.camera.camera_world import (
    CLEAN,
    CameraView,
    Matrix,
    camera,
    shipped_camera,
    start_view,
)
from tests.plant_emulator.camera.test_corner_accuracy import corner_errors, random_views, rms

LIMIT = 2.0  # times the peer: a pair with lens, blur, noise and vignetting on
PLATE_PX_PER_M = 2000.0
PINHOLE = {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}


class WarpingPeer:
    """The same scene by warpPerspective, no mip levels, no lens distortion: what most people write."""

    def __init__(self, eyes: StereoCamera) -> None:
        self.scene, self.config = eyes.scene, eyes.config
        self._eyes = eyes
        wall = eyes.scene.config.wall
        self._wall = wall_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)
        self._plates = {
            id(plate): painted(plate) for plate in (*eyes.scene.wall_plates, *eyes.scene.tool_plates)
        }

    def project_corners(self, X_WC: Matrix, X_WM: Matrix) -> dict[int, tuple[Matrix, Matrix]]:
        """The exact corners, from the camera under test."""
        return self._eyes.project_corners(X_WC, X_WM)

    def render(self, X_WC: Matrix, X_WM: Matrix, frame_id: int) -> tuple[np.ndarray, np.ndarray]:
        """A pair."""
        view = CameraView(X_WC, X_WM)
        return self.render_eye(LEFT, view, frame_id), self.render_eye(RIGHT, view, frame_id)

    def render_eye(self, eye: int, view: CameraView, frame_id: int) -> np.ndarray:
        """One picture, no noise."""
        lens, size = self._eyes.eyes[eye].lens, (self.config.width_px, self.config.height_px)
        (fx, fy), (cx, cy) = lens.focal, lens.centre
        camera_matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        X_EW = np.linalg.inv(view.X_WC @ self._eyes.eyes[eye].true.X_CE)
        X_EO = X_EW @ self.scene.mounts.X_WO
        first = (0.5 - SIZE / 2) * 1e-3
        to_wall = np.array([[1e-3, 0, first], [0, 1e-3, first], [0, 0, 1]])
        picture = cv2.warpPerspective(
            self._wall,
            camera_matrix @ plane(X_EO) @ to_wall,
            size,
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        parents = [(X_EO, self.scene.wall_plates), (X_EW @ view.X_WM, self.scene.tool_plates)]
        for X_E_parent, plates in parents:
            for plate in plates:
                X_EP = X_E_parent @ plate.X_parent_plate
                if X_EP[:3, 2] @ X_EP[:3, 3] < 0.0:
                    image, to_plate = self._plates[id(plate)]
                    paste(picture, image, camera_matrix @ plane(X_EP) @ to_plate)
        return picture


def paste(picture: np.ndarray, image: np.ndarray, homography: Matrix) -> None:
    """Warp ``image`` into ``picture`` in place, within its bounding box only."""
    height, width = image.shape
    corners = homography @ np.array([[0, width, width, 0], [0, 0, height, height], [1, 1, 1, 1]])
    if (corners[2] < 0.02).any():
        return
    corners = corners[:2] / corners[2]
    left, top = np.clip(np.floor(corners.min(axis=1)).astype(int), 0, [1280, 720])
    right, bottom = np.clip(np.ceil(corners.max(axis=1)).astype(int) + 1, 0, [1280, 720])
    if left >= right or top >= bottom:
        return
    shifted = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]]) @ homography
    size = (int(right - left), int(bottom - top))
    grey = cv2.warpPerspective(image, shifted, size, flags=cv2.INTER_LINEAR)
    inside = cv2.warpPerspective(np.full_like(image, 255), shifted, size, flags=cv2.INTER_NEAREST)
    region = picture[top:bottom, left:right]
    region[inside > 0] = grey[inside > 0]


def painted(plate: Plate) -> tuple[np.ndarray, Matrix]:
    """The plate as a picture, and the map from its pixels to metres (x right, y down)."""
    left, top = plate.edges_x[0], plate.edges_y[0]
    x = left + (np.arange(round((plate.edges_x[-1] - left) * PLATE_PX_PER_M)) + 0.5) / PLATE_PX_PER_M
    y = top + (np.arange(round((plate.edges_y[-1] - top) * PLATE_PX_PER_M)) + 0.5) / PLATE_PX_PER_M
    columns = np.clip(np.searchsorted(plate.edges_x, x) - 1, 0, plate.grey.shape[1] - 1)
    rows = np.clip(np.searchsorted(plate.edges_y, y) - 1, 0, plate.grey.shape[0] - 1)
    image = plate.grey[np.ix_(rows, columns)].astype(np.uint8)
    return image, np.array([[1 / PLATE_PX_PER_M, 0, x[0]], [0, 1 / PLATE_PX_PER_M, y[0]], [0, 0, 1]])


def plane(X_EP: Matrix) -> Matrix:
    """From metres on a plane (x right, y down) to the eye's axes."""
    return np.stack([X_EP[:3, 0], -X_EP[:3, 1], X_EP[:3, 3]], axis=1)


def milliseconds_a_pair(eyes: StereoCamera | WarpingPeer, view: CameraView, rounds: int = 40) -> float:
    """Median CPU time of one thread for a stereo pair."""
    times = []
    for frame_id in range(rounds):
        begun = time.thread_time()
        eyes.render(view.X_WC, view.X_WM, frame_id)
        times.append(time.thread_time() - begun)
    return 1e3 * float(np.median(times[3:]))


@pytest.fixture
def one_thread() -> object:
    """OpenCV on one thread, as in the renderer."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield None
    cv2.setNumThreads(before)


@pytest.mark.bench
@pytest.mark.usefixtures("one_thread")
def test_rendering_beside_warping(record_property) -> None:  # type: ignore[no-untyped-def]
    clean = CLEAN | {"camera": CLEAN["camera"] | {"lens": PINHOLE}}
    ours = camera(clean)
    rows = {}
    for name, eyes in (("longreach", ours), ("warpPerspective", WarpingPeer(ours))):
        error = rms(corner_errors(eyes, random_views(ours, 100, seed=1)))  # type: ignore[arg-type]
        rows[name] = (milliseconds_a_pair(eyes, start_view(ours.scene)), error)
    full = milliseconds_a_pair(shipped_camera(), start_view(shipped_camera().scene))
    print("\nrenderer, 1280x720 pair, one core        ms a pair   corner error, px rms")
    for name, (milliseconds, error) in rows.items():
        print(f"{name + ', pinhole, no noise, no blur':40s} {milliseconds:9.1f} {error:22.4f}")
        record_property(name, {"ms": milliseconds, "corner_rms_px": error})
    print(f"{'longreach, lens, blur, noise, vignetting':40s} {full:9.1f}")
    record_property("longreach_full_ms", full)
    warped = rows["warpPerspective"][0]
    print(f"everything on: {full / warped:.2f} times warpPerspective without any of it, limit {LIMIT:g}")
    assert full <= LIMIT * warped
    assert rows["longreach"][1] <= 0.02
    assert rows["longreach"][1] < rows["warpPerspective"][1] / 5
