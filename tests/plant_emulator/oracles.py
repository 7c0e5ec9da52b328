"""The plant's mechanism in two other engines: MuJoCo and Pinocchio."""

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from plant_emulator.core.mechanics.multibody import Mechanism

Array = NDArray[np.float64]


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def mujoco_xml(mech: Mechanism, options: str = "") -> str:
    """An MJCF document of ``mech``: nested bodies in base axes; a massless body joins the next one."""
    opened: list[str] = []
    joints: list[str] = []
    for i in range(len(mech.mass)):
        joints.append(
            f'<joint name="angle {i}" type="hinge" axis="{_text(mech.axis[i])}" pos="{_text(mech.point[i])}"'
            f' stiffness="{float(mech.stiffness[i])!r}" damping="{float(mech.damping[i])!r}"/>'
        )
        if mech.mass[i] == 0.0:
            continue
        full = mech.inertia[i][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        opened.append(
            f"<body>{''.join(joints)}<inertial pos='{_text(mech.centre[i])}' mass='{float(mech.mass[i])!r}'"
            f" fullinertia='{_text(full)}'/>"
        )
        joints.clear()
    return (
        "<mujoco><compiler balanceinertia='false' boundmass='0' boundinertia='0' angle='radian'/>"
        f"<option gravity='{_text(mech.gravity)}' {options}>"
        "<flag contact='disable' constraint='disable'/></option>"
        f"<worldbody>{''.join(opened)}{'</body>' * len(opened)}</worldbody></mujoco>"
    )


class MujocoArm:
    """``mech`` in MuJoCo; hinge springs are part of the caller's force."""

    def __init__(self, mech: Mechanism) -> None:
        rigid = mech._replace(stiffness=np.zeros_like(mech.mass), damping=np.zeros_like(mech.mass))
        self._model = mujoco.MjModel.from_xml_string(mujoco_xml(rigid))
        self._data = mujoco.MjData(self._model)

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        self._data.qpos[:], self._data.qvel[:], self._data.qfrc_applied[:] = q, rate, force
        mujoco.mj_forward(self._model, self._data)
        return np.array(self._data.qacc)


class PinocchioArm:
    """``mech`` in Pinocchio: its own articulated-body algorithm, joint frames on the axes."""

    def __init__(self, mech: Mechanism) -> None:
        self._model, parent, origin = pin.Model(), 0, np.zeros(3)
        for i in range(len(mech.mass)):
            joint = pin.JointModelRevoluteUnaligned(*(float(a) for a in mech.axis[i]))
            parent = self._model.addJoint(parent, joint, pin.SE3(np.eye(3), mech.point[i] - origin), f"{i}")
            inertia = pin.Inertia(float(mech.mass[i]), mech.centre[i] - mech.point[i], mech.inertia[i])
            self._model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            origin = mech.point[i]
        self._model.gravity = pin.Motion(mech.gravity, np.zeros(3))
        self._data = self._model.createData()

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        return np.array(pin.aba(self._model, self._data, q, rate, force))

    def energies(self, q: Array, rate: Array) -> tuple[float, float]:
        """Kinetic energy and gravity's potential (J)."""
        kinetic = pin.computeKineticEnergy(self._model, self._data, q, rate)
        return float(kinetic), float(pin.computePotentialEnergy(self._model, self._data, q))
