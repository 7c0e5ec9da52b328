"""What the emulator does where real machines have public figures: steps, drift, loops, a circle, rocking."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load, parse_overrides
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import columns as col
from plant_emulator.core.mechanics.linkage import actuator_position
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.lockstep.clock import run
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.run_log import RunLog
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.scenarios.settings import load_settings

CONFIGS = Path(__file__).parents[1] / "configs"
MOBILE = "plant.valve_set=mobile"
RADIUS_M = 0.05
SPEED_M_S = 0.02
_MOVED_RAD = 2e-3
_TICK_NS = 2_000_000
_STEP_S = 1.5
_LIFT, _TILT = 1, 2
_SEND_S = 0.02
_BEGIN_S = 4.0  # of the circle, during which the arm starts from rest

Array = NDArray[np.float64]
Spools = tuple[float, float, float, float, float, float]


class StepAnswer(NamedTuple):
    """A step of one valve: when its joint had moved by 2 mrad (s), its speed after that (rad/s)."""

    delay_s: float
    speed: float


def plant(*assignments: str) -> Plant:
    """The default arm with ``assignments``, at rest for half a second."""
    changes = parse_overrides(assignments).get("plant")
    arm = Plant(load(PlantConfig, CONFIGS / "plant.yaml", changes), 1)
    arm.advance(500_000_000)
    return arm


def driven(arm: Plant, spools: Spools, seconds: float) -> Iterator[Plant]:
    """The arm every 2 ms under an open-loop command."""
    for cycle in range(1, round(seconds * 1e9 / _TICK_NS) + 1):
        arm.write(ValveImage(cycle, CONTROL_ENABLE, spools))
        arm.advance(_TICK_NS)
        yield arm


def stepped(axis: int, spool: float, *assignments: str) -> StepAnswer:
    """The answer of one joint to a step of its valve."""
    arm = plant(*assignments)
    slew, lift, tilt = (spool if k == axis else 0.0 for k in range(3))
    begin = arm.truth().q[axis]
    way = np.array(
        [abs(now.truth().q[axis] - begin) for now in driven(arm, (slew, lift, tilt, 0.0, 0.0, 0.0), _STEP_S)]
    )
    moved = int(np.argmax(way > _MOVED_RAD))
    times = 1e-9 * _TICK_NS * np.arange(1, len(way) + 1)
    late = times > _STEP_S - 0.5
    return StepAnswer(float(times[moved]), float(np.polyfit(times[late], way[late], 1)[0]))


def stroke_s() -> float:
    """How long the lift's spool takes from the centre to 95 % of its stroke, mobile valves."""
    arm = plant(MOBILE)
    for count, now in enumerate(driven(arm, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0), 0.6), 1):
        if abs(now.truth().spools[1]) > 0.95:
            return 1e-9 * _TICK_NS * count
    return float("nan")


def rocking_deg_s() -> float:
    """Rate of the base while the slew starts, turns and stops, rms over 4 s, degrees a second."""
    arm = plant("plant.errors.rocking_base.enabled=true", "plant.errors.vibration.enabled=true")
    turned = []
    for spool in (0.05, 0.0, -0.05, 0.0):
        turned += [now.truth().X_WB[:3, :3] for now in driven(arm, (spool, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)]
    steps = [now @ before.T for before, now in pairwise(turned)]
    small = np.array([[step[2, 1], step[0, 2], step[1, 0]] for step in steps])
    return float(np.degrees(np.sqrt(np.mean((small**2).sum(axis=1)))) / (1e-9 * _TICK_NS))


def drift_mm(minutes: float, *assignments: str) -> Array:
    """How far (2,) the rods of lift and tilt have gone in with the valves shut and 100 kg at the tool."""
    arm = plant("plant.payload.mass_kg=100", *assignments)
    arm.advance(5_000_000_000)
    rods = [_rods_m(arm)]
    for _ in range(round(60.0 * minutes)):
        arm.advance(1_000_000_000)
    rods.append(_rods_m(arm))
    return np.asarray(1e3 * np.abs(rods[1] - rods[0]))


def _rods_m(arm: Plant) -> Array:
    """Piston positions (2,) of lift and tilt."""
    q, table = arm.truth().q, arm.model.actuators
    return np.array([actuator_position(q[i], *table[i, : col.A_LENGTH0 + 1]) for i in (_LIFT, _TILT)])


def hysteresis_percent() -> float:
    """Width of the loop between command and spool of the lift's mobile valve, in percent of the stroke.

    The command goes up and down slowly between half and full stroke; the loop is read in its middle.
    """
    arm = plant(MOBILE)
    ramp = np.linspace(0.5, 1.0, 400)
    spools = {}
    for name, told in (("up", ramp), ("down", ramp[::-1])):
        loop = []
        for command in told:
            *_, now = driven(arm, (0.0, float(command), 0.0, 0.0, 0.0, 0.0), 0.02)
            loop.append(float(now.truth().spools[_LIFT]))
        spools[name] = loop
    middle = len(ramp) // 2
    return 100.0 * (spools["down"][middle] - spools["up"][middle])


def circled_mm(*assignments: str) -> Array:
    """Radial errors (n,) of a streamed upright circle of 50 mm radius at 20 mm/s, by the encoders."""
    rig = LockstepRig(
        load_settings(CONFIGS, parse_overrides(assignments)), 1, RunLog(),
        lambda world: simulated_sight(world, load_eye_model(CONFIGS), 1),
    )  # fmt: skip
    rig.command("enable")
    return np.asarray(1e3 * run(_circle(rig)))


async def _circle(rig: LockstepRig) -> Array:
    """Radial errors (m) over one lap, after the start."""
    arm, clock = rig.application.arm, rig.world.clock
    X = (await arm.view()).X_BT.copy()
    centre = X[:3, 3] - [RADIUS_M, 0.0, 0.0]
    turning = SPEED_M_S / RADIUS_M
    errors = []
    async with arm.streaming() as stream:
        for now in np.arange(0.0, _BEGIN_S + 2.0 * np.pi / turning, _SEND_S):
            out = np.array([np.cos(turning * now), 0.0, np.sin(turning * now)])
            along = np.array([-out[2], 0.0, out[0]])
            X[:3, 3] = centre + RADIUS_M * out
            await stream.send(X, twist_ref=np.concatenate([SPEED_M_S * along, np.zeros(3)]))
            await clock.until(lambda: False, _SEND_S)
            off = (await stream.view()).X_BT[:3, 3] - centre
            if now >= _BEGIN_S:
                errors.append(np.hypot(off[0], off[2]) - RADIUS_M)
    return np.array(errors)
