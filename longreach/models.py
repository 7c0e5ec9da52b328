"""Parts without a rig: the nominal arm's kinematics, and the plant, stepped by hand."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller.core.kinematics.denavit_hartenberg import chain, dh_table, geometric_jacobian, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from longreach.rigs import CONFIGS, Assignments, configured
from nominal_arm.description import NominalArm
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.errors import RequestRefused
from protocol.process_image import CONTROL_ENABLE, SensorImage, ValveImage

Array = NDArray[np.float64]


class ArmKinematics:
    """The nominal arm as the controller computes it. Joint angles (6,) in rad, in arm.yaml's order."""

    def __init__(self, description: NominalArm) -> None:
        self.description = description
        self._table = dh_table(description.dh)

    def fk(self, q: ArrayLike) -> Array:
        """X_BT (4, 4): the tool centre point in the base. Raises RequestRefused unless given six numbers."""
        return tool_pose(self._table, _finite(q, (6,), "q"))

    def jacobian(self, q: ArrayLike) -> Array:
        """J_BT (6, 6): velocity of T over its angular velocity, in B, per joint rate; raises as ``fk``."""
        return geometric_jacobian(chain(self._table, _finite(q, (6,), "q")))

    def ik(self, X_BT: ArrayLike, near: ArrayLike) -> Array:
        """The angles (6,) that put T at ``X_BT``, with elbow and wrist bent as in ``near``.

        Joint limits are not asked. Raises RequestRefused (``refused.unreachable``) when the boom does not
        reach there.
        """
        X, branch = _finite(X_BT, (4, 4), "X_BT"), _finite(near, (6,), "near")
        R, p = np.ascontiguousarray(X[:3, :3]), np.ascontiguousarray(X[:3, 3])
        verdict, q, distance, limit = joint_angles(self._table, R, p, branch)
        if verdict != REACHED:
            raise RequestRefused(
                "refused.unreachable",
                f"X_BT: {distance:.3f} m from lift pivot to wrist, the boom's limit is {limit:.3f} m",
            )
        return q


class SteppedPlant:
    """The arm, its oil and its sensors without a controller; bit-identical for one seed.

    ``physics`` is the plant itself: payload, faults, vibrations.
    """

    def __init__(self, physics: Plant) -> None:
        self.physics = physics
        self._cycle = 0

    def step(self, valves: Sequence[float], dt_s: float = 0.005) -> SensorImage:
        """The sensors ``dt_s`` of simulated time after six spool commands in −1…1 were given.

        Raises RequestRefused (``request.invalid``) for other commands and times. With ``dt_s`` over the
        plant's watchdog the valves close by themselves, as they do when a controller dies.
        """
        slew, lift, tilt, wrist1, wrist2, wrist3 = _finite(valves, (6,), "valves").tolist()
        if not 0.0 < dt_s <= 60.0:
            raise RequestRefused("request.invalid", f"dt_s = {dt_s}: must lie in 0…60 s")
        self._cycle += 1
        commands = (slew, lift, tilt, wrist1, wrist2, wrist3)
        self.physics.write(ValveImage(self._cycle & 0xFFFFFFFF, CONTROL_ENABLE, commands))
        self.physics.advance(round(1e9 * dt_s))
        return self.physics.read()

    @property
    def truth(self) -> PlantTruth:
        """Where everything really is now."""
        return self.physics.truth()


def arm(
    name: str | None = None, set: Assignments | None = None, config_dir: Path | str = CONFIGS
) -> ArmKinematics:
    """The nominal arm of this name, or of a directory; None: of ``config_dir``. Raises ConfigurationError."""
    return ArmKinematics(configured(config_dir, name, None, 0, set).arm)


def plant(
    scenario: str | None = None,
    seed: int = 1,
    set: Assignments | None = None,
    config_dir: Path | str = CONFIGS,
    arm: str | None = None,
) -> SteppedPlant:
    """The plant at rest, in the world that ``scenario`` draws for ``seed`` (None: as configured).

    ``arm``: a name or a directory, as the command line's ``--arm``.

    Raises ConfigurationError.
    """
    settings = configured(config_dir, arm, scenario, seed, set)
    return SteppedPlant(Plant(settings.plant, seed, Scene(settings.scene).mounts))


def _finite(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.shape != shape or not np.isfinite(found).all():
        raise RequestRefused(
            "request.invalid", f"{name} = {found.tolist()}: wanted finite numbers of shape {shape}"
        )
    return found
