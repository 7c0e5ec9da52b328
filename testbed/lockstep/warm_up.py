"""Compiles every numba kernel once, into its cache: a part of set-up and of the image.

numba compiles on one core, so parts that share no kernel are compiled side by side, each in a process of its
own. A short life of all services in lockstep then compiles what they left.
"""

import ctypes
import multiprocessing
import operator
import os
import signal
import sys
from collections.abc import Callable

import numpy as np

from controller.core.settings import settings_from
from controller.shell.cyclic_task import warm_up as scan_a_little
from foundation.command_options import usual_configs
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import bars
from testbed.scenarios.scenario import Settings, load_settings
from vision_pc.core import se3
from vision_pc.core.odometry.stereo_odometry import StereoOdometry
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.types import StereoPair

_FACING = np.diag([1.0, -1.0, -1.0])  # a camera that looks at the wall


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


def _eyes() -> None:
    """Two pictures of the object with the tool before it: rendered, looked at, followed."""
    settings = _settings()
    scene, vision = Scene(settings.scene), settings.vision
    eyes = StereoCamera(settings.scene.camera, scene, 1)
    camera = intrinsics.calibration(vision.camera)
    odometry = StereoOdometry(camera, vision.odometry)
    X_WM = scene.mounts.X_WO @ se3.transform(np.eye(3), (0.1, -0.2, 0.1))
    for number in range(2):
        X_WC = scene.mounts.X_WO @ se3.transform(_FACING, (0.02 * number, 0.0, 1.2))
        pair = StereoPair(*eyes.render(X_WC, X_WM, number), round(1e8 * number), number)
        look.observe(pair, camera, vision.markers)
        odometry.process(pair)


def _whole_life() -> None:
    rig = LockstepRig(_settings(), 1, RunLog())
    rig.command("enable")
    with bars(quiet=True) as shown, shown.step("look") as bar:
        rig.operate("look", {"frames": 1}, bar)


PARTS: tuple[Callable[[], None], ...] = (_controller, _eyes, _plant)  # longest first


def _end_with_parent() -> None:
    """A worker whose parent was ended ends too: it holds a gigabyte, and would compile to its end."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def main() -> int:
    """Exit status 0, when all is compiled: a bar tells how much is."""
    processes = min(len(PARTS), os.cpu_count() or 1)
    with bars() as shown, shown.step("compiling kernels, once") as bar:
        with multiprocessing.get_context("spawn").Pool(processes, _end_with_parent) as pool:
            for done, _ in enumerate(pool.imap_unordered(operator.call, PARTS), 1):
                bar.update(done / (len(PARTS) + 1))
        _whole_life()
    return 0


if __name__ == "__main__":
    sys.exit(main())
