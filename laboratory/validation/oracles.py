"""The same arm in MuJoCo and in Pinocchio: oracles that share no line of dynamics with the plant."""

import importlib
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.mechanics.multibody import Mechanism
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]
MISSING_ORACLE = "configuration.missing_oracle"


def oracle(name: str) -> ModuleType:
    """The module of an oracle. Raises ConfigurationError when it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            MISSING_ORACLE, f"{name}, an independent oracle, is not installed: make setup-dev"
        ) from error


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def mujoco_xml(mech: Mechanism, options: str = "") -> str:
    """An MJCF document of ``mech``: nested bodies in base axes; a massless body joins the next one."""
    opened, depth = [], 0
    joints: list[str] = []
    for i in range(len(mech.mass)):
        joints.append(
            f'<joint name="angle {i}" type="hinge" axis="{_text(mech.axis[i])}" pos="{_text(mech.point[i])}"'
            f' stiffness="{float(mech.stiffness[i])!r}" damping="{float(mech.damping[i])!r}"/>'
        )
        if mech.mass[i] == 0.0:
            continue
        inertia = mech.inertia[i]
        full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        opened.append(
            f"<body>{''.join(joints)}<inertial pos='{_text(mech.centre[i])}' mass='{float(mech.mass[i])!r}'"
            f" fullinertia='{_text(np.array(full))}'/>"
        )
        joints.clear()
        depth += 1
    return (
        "<mujoco><compiler balanceinertia='false' boundmass='0' boundinertia='0' angle='radian'/>"
        f"<option gravity='{_text(mech.gravity)}' {options}>"
        "<flag contact='disable' constraint='disable'/></option>"
        f"<worldbody>{''.join(opened)}{'</body>' * depth}</worldbody></mujoco>"
    )


class MujocoArm:
    """``mech`` in MuJoCo, hinge springs left to the caller's force unless stepped by MuJoCo itself."""

    def __init__(self, mech: Mechanism) -> None:
        self._mujoco = oracle("mujoco")
        rigid = mech._replace(stiffness=np.zeros_like(mech.mass), damping=np.zeros_like(mech.mass))
        self._model = self._mujoco.MjModel.from_xml_string(mujoco_xml(rigid))
        self._data = self._mujoco.MjData(self._model)

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        self._data.qpos[:], self._data.qvel[:], self._data.qfrc_applied[:] = q, rate, force
        self._mujoco.mj_forward(self._model, self._data)
        return np.array(self._data.qacc)


class PinocchioArm:
    """``mech`` in Pinocchio: its own articulated-body algorithm, joint frames on the axes."""

    def __init__(self, mech: Mechanism) -> None:
        self._pin = pin = oracle("pinocchio")
        self._model, parent, origin = pin.Model(), 0, np.zeros(3)
        for i in range(len(mech.mass)):
            joint = pin.JointModelRevoluteUnaligned(*(float(a) for a in mech.axis[i]))
            parent = self._model.addJoint(
                parent, joint, pin.SE3(np.eye(3), mech.point[i] - origin), f"angle {i}"
            )
            inertia = pin.Inertia(float(mech.mass[i]), mech.centre[i] - mech.point[i], mech.inertia[i])
            self._model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            origin = mech.point[i]
        self._model.gravity = pin.Motion(mech.gravity, np.zeros(3))
        self._data = self._model.createData()

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        return np.array(self._pin.aba(self._model, self._data, q, rate, force))

    def energies(self, q: Array, rate: Array) -> tuple[float, float]:
        """Kinetic energy and gravity's potential (J)."""
        kinetic = self._pin.computeKineticEnergy(self._model, self._data, q, rate)
        return float(kinetic), float(self._pin.computePotentialEnergy(self._model, self._data, q))
