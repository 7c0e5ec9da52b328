"""A rig for guided sessions that is always at rest: an arm where it was told, the emulator's pictures."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from controller.core.kinematics.denavit_hartenberg import dh_table
from controller.core.kinematics.inverse_kinematics import joint_angles
from foundation.configuration import merged
from foundation.event_log import EventLog
from nominal_arm.dimensions import dimensions
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from protocol.errors import RequestRefused
from protocol.faults import FaultCode, GroupState, Severity
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.session_store import SessionStore
from vision_pc.core import se3
from vision_pc.core.ports import ArmView, PairsAtRest
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoPair

T = TypeVar("T")
START_RAD = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
X_BT_START = se3.transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([3.89355, 0.0, 1.00825])
)


def still_settings(seed: int = 1, **overrides: Any) -> Settings:
    """The hand-eye scenario's world; ``overrides`` by file."""
    drawn = chosen_overrides(CONFIGS, "hand_eye", seed, [])
    return load_settings(CONFIGS, merged(drawn, overrides))


class StillRig:
    """Implements the arm, the camera and the states that ``GuidedCalibration`` works with.

    ``refuse``: says why a pose is refused (None: it is not). ``settled``, ``drift_mrad``: how the arm stands;
    it drifts by as much between two views. ``robot_m``, ``robot_rad``: how wrong its pose is, a component.
    """

    def __init__(
        self, settings: Settings, sessions: Path, robot_m: float = 0.0, robot_rad: float = 0.0
    ) -> None:
        self.settings = settings
        self.scene = Scene(settings.scene)
        self.camera = StereoCamera(settings.scene.camera, self.scene, settings.scene.seed)
        self.X_BT, self.X_BT_true = X_BT_START, X_BT_START
        self.refuse: Callable[[Array], str | None] = lambda _pose: None
        self.settled, self.drift_mrad = True, 0.0
        self.moves: list[Array] = []
        self._table = dh_table(settings.arm.dh)
        self._robot = (robot_m, robot_rad)
        self._rng = np.random.default_rng(5)
        self._time_ns = self._frame = self._views = 0
        self.log = EventLog("vision_pc", io.StringIO())
        self.guided = GuidedCalibration(
            self, self, self, settings.vision, dimensions(settings.arm), self.log, SessionStore(sessions)
        )

    @property
    def X_TC(self) -> Array:
        """The camera in the hand as it truly is."""
        return self.scene.mounts.X_TC

    async def view(self) -> ArmView:
        self._views += 1
        _, q, _, _ = joint_angles(self._table, self.X_BT[:3, :3], self.X_BT[:3, 3], START_RAD)
        q = q + 1e-3 * self.drift_mrad * self._views
        return ArmView(
            self._time_ns, GroupState.STANDBY, FaultCode.NONE, Severity.NONE, len(self.moves), True,
            self.settled, q, q, self.X_BT, self.X_BT,
        )  # fmt: skip

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        why = self.refuse(X_BT_ref)
        if why is not None:
            raise RequestRefused(f"refused.{why}", f"reference pose refused: {why.replace('_', ' ')}")
        self.moves.append(X_BT_ref)
        self.X_BT = X_BT_ref
        noise = self._rng.normal(size=6) * np.repeat(self._robot, 3)
        self.X_BT_true = se3.retract(X_BT_ref, noise)
        return await self.view()

    async def halt(self) -> None:
        pass

    async def next_state(self) -> Any:
        self._time_ns += 100_000_000

    async def pairs_at_rest(self, frames: int) -> PairsAtRest:
        X_WT = self.scene.mounts.X_WB @ self.X_BT_true
        pairs = []
        for _ in range(frames):
            self._frame += 1
            left, right = self.camera.render(
                X_WT @ self.scene.mounts.X_TC, X_WT @ self.scene.mounts.X_TM, self._frame
            )
            pairs.append(StereoPair(left, right, self._frame * 100_000_000, self._frame))
        return PairsAtRest(tuple(pairs), self.X_BT)

    async def aside(self, work: Callable[[], T]) -> T:
        return work()


def quiet(_progress: float, _note: str) -> None:
    """A report that nobody reads."""
