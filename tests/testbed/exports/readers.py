"""MuJoCo and Pinocchio as readers of exported files: tool pose and accelerations by joint names."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from testbed.exports.arm_tree import TOOL
from vision_pc.core.se3 import Array, transform


class MujocoReader:
    """What MuJoCo makes of a document."""

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self._data = mujoco.MjData(self.model)
        self._tool = self.model.body(TOOL).id
        self.names = [self.model.joint(i).name for i in range(self.model.njnt)]

    def pose(self, q: Array) -> Array:
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self.model, self._data)
        return transform(self._data.xmat[self._tool].reshape(3, 3), self._data.xpos[self._tool])


class PinocchioReader:
    """What Pinocchio makes of a document."""

    def __init__(self, path: Path) -> None:
        self.model = pin.buildModelFromUrdf(str(path))
        self._data = self.model.createData()
        self._tool = self.model.getFrameId(TOOL)

    def pose(self, q: Array) -> Array:
        pin.framesForwardKinematics(self.model, self._data, q)
        return np.array(self._data.oMf[self._tool].homogeneous)

    def acceleration(self, q: Array, rate: Array, force: Array, gravity: Array) -> Array:
        self.model.gravity = pin.Motion(gravity, np.zeros(3))
        return np.array(pin.aba(self.model, self._data, q, rate, force))


READERS = (MujocoReader, PinocchioReader)

_OFF = {"enabled": False}
_ERRORS = "encoder_offsets encoder_noise backlash geometry base_tilt friction leakage valve_deadband"
STIFF = {"plant": {"errors": dict.fromkeys(_ERRORS.split(), _OFF), "flexibility": _OFF}}
"""Overrides of a plant that moves as its drawing says."""
