"""Compiles every numba kernel once, into its cache: a part of set-up and of the image.

Compiling takes one core each minute of a life, so parts that share no kernel are compiled side by side, each
in a process of its own. A short life of all services in lockstep finds what they left, and proves the cache.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed

import cv2
import numpy as np

from controller.core.settings import settings_from
from controller.shell.warm_up import warm_up as scan_a_little
from foundation.command_options import usual_configs
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.reporting.console import bars
from testbed.scenarios.settings import Settings, load_settings
from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry.stereo_odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image, StereoPair

_FACING = np.diag([1.0, -1.0, -1.0])  # a camera or a marker that looks the other one in the face


def _settings() -> Settings:
    return load_settings(usual_configs(), {})


def _controller() -> None:
    settings = _settings()
    scan_a_little(settings_from(settings.arm, settings.controller))


def _plant() -> None:
    settings = _settings()
    plant = Plant(settings.plant, 1, Scene(settings.scene).mounts)
    plant.advance(2_000_000)
    plant.truth()


def _camera() -> None:
    config = _settings().scene
    scene = Scene(config)
    X_WC = scene.mounts.X_WO @ se3.transform(_FACING, (0.0, 0.0, 1.2))
    X_WM = X_WC @ se3.transform(_FACING, (0.1, 0.2, 1.0))
    StereoCamera(config.camera, scene, 1).render(X_WC, X_WM, 0)


def _perception() -> None:
    vision = _settings().vision
    camera = intrinsics.calibration(vision.camera)
    odometry = StereoOdometry(camera, vision.odometry)
    for x_m in (0.0, 0.02):
        pair = _drawn(camera, vision.markers, x_m)
        look.observe(pair, camera, vision.markers)
        odometry.process(pair)


def _drawn(camera: CameraCalibration, markers: MarkerSettings, x_m: float) -> StereoPair:
    """The markers on a slanted wall of noise, as a camera ``x_m`` farther right sees them."""
    X_CW = se3.transform(se3.exp_so3(np.radians((15.0, -20.0, 0.0))), (-x_m, 0.0, 1.2))
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, markers.dictionary))
    noise = np.random.default_rng(1).integers(0, 256, (camera.height // 2, camera.width // 2), np.uint8)
    white = np.full((280, 280), 255, np.uint8)
    wall = np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.0), np.uint8)
    laid: list[tuple[Image, tuple[float, float, float]]] = [(wall, (0.0, 0.0, 4.0))]
    for number, x, y, size in [
        (markers.tool.id, 0.0, -0.2, markers.tool.size_m),
        *((one.id, one.x_m, one.y_m, one.size_m) for one in markers.object),
    ]:
        printed = np.asarray(cv2.aruco.generateImageMarker(dictionary, number, 280), np.uint8)
        laid += [(white, (x, y, 1.5 * size)), (printed, (x, y, size))]
    pictures = []
    for eye in (camera.left, camera.right):
        picture = np.zeros((camera.height, camera.width), np.uint8)
        for printed, square in laid:
            _lay(picture, printed, intrinsics.project(eye, se3.apply(X_CW, _corners(*square))))
        pictures.append(picture)
    return StereoPair(pictures[0], pictures[1], round(1e9 * x_m), round(100 * x_m))


def _corners(x: float, y: float, size: float) -> Array:
    """Corners (4, 3), m, of a square on the wall, from upper left clockwise as the camera sees it."""
    signs = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return np.asarray((x, y, 0.0) + 0.5 * size * signs)


def _lay(picture: Image, printed: Image, corners: Array) -> None:
    """Lay ``printed`` into ``picture``, in place, with its corners at ``corners`` (4, 2) px."""
    height, width = printed.shape
    own = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    H = cv2.getPerspectiveTransform(own.astype(np.float32), corners.astype(np.float32))
    size = (picture.shape[1], picture.shape[0])
    cv2.warpPerspective(
        printed, H, size, dst=picture, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_TRANSPARENT
    )


def _whole_life() -> None:
    rig = LockstepRig(_settings(), 1, RunLog())
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("look") as bar:
        rig.operate("look", {"frames": 1}, bar)


PARTS: tuple[Callable[[], None], ...] = (_controller, _perception, _camera, _plant)  # longest first


def main() -> int:
    """Exit status 0, when all is compiled: a bar tells how much is."""
    processes = min(len(PARTS), os.cpu_count() or 1)
    spawned = multiprocessing.get_context("spawn")
    with bars() as shown, shown.step("compiling kernels, once") as bar:
        with ProcessPoolExecutor(processes, mp_context=spawned) as pool:
            for done, part in enumerate(as_completed([pool.submit(part) for part in PARTS]), 1):
                part.result()
                bar.update(done / (len(PARTS) + 1))
        _whole_life()
    return 0


if __name__ == "__main__":
    sys.exit(main())
