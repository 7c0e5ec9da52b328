"""What makes rigid-body positioning wrong over the workspace, and how the arm rings, for both arms.

All of it is the truth of the plant against what its encoders tell; no part of the controller is used.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load, merged
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.units import BAR, LITRE_PER_MINUTE
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import DRIVEN, N_COORDINATES
from plant_emulator.core.mechanics.linkage import actuator_lever
from plant_emulator.core.mechanics.multibody import forward_kinematics, multibody_work
from plant_emulator.core.model import build_model, orifice_gain
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage
from testbed.validation.plant_rig import NO_ERRORS

Array = NDArray[np.float64]

CYCLE_S, SERVO_S, OFF_MRAD = 5e-3, 8.0, 20.0
SERVO_GAINS = np.array([2.0, 2.0, 2.0, 8.0, 8.0, 8.0])  # 1/s, which either arm bears without other measures
BLEND = 3e-4  # of spool, over which a compensation of the deadband fades in
RIGID = {**NO_ERRORS, "flexibility": {"enabled": False}}


class SurveyedArm(NamedTuple):
    """An arm to survey: its file, the masses (kg) beyond the wrist to sag under, the poses of its grid."""

    name: str
    file: str
    loads_kg: tuple[float, ...]
    lifts_deg: tuple[int, ...]
    tilts_deg: tuple[int, ...]


ARMS = (
    SurveyedArm("default arm", "plant.yaml", (30.0, 70.0, 130.0, 230.0), (0, 15, 30, 45, 60, 75, 90),
        (-130, -110, -90, -70, -50, -30)),
    SurveyedArm("long crane", "arms/long_crane/plant.yaml", (90.0, 150.0, 250.0), (0, 15, 30, 45, 60, 75),
        (-120, -100, -80, -60, -40)),
)  # fmt: skip
STATED_REACH_M, STATED_SAG_MM = 4.1, {30.0: 13.0, 130.0: 28.0, 230.0: 43.0}  # of an earlier model of this arm
STATED_PLAY_MM = 1.5  # at the tip of about 5 m


class SurveyRow(NamedTuple):
    """One pose, tool level, the bare wrist: lengths at the tool.

    ``sag_mm`` under each load of the arm. ``play_mm``: how far to either side the slew may stand of its
    reading. ``believed_mm``: the true tool off that of encoders and nominal, rigid geometry. ``servo_mm``:
    where a proportional servo rests by its own reading, without and with its valves' deadband compensated.
    Then the lowest mode with all valves shut.
    """

    arm: str
    lift_deg: float
    tilt_deg: float
    reach_m: float
    sag_mm: tuple[float, ...]
    play_mm: float
    believed_mm: float
    servo_mm: tuple[float, float]
    lowest_hz: float
    damping: float


def survey(
    config_dir: Path, arm: SurveyedArm, lifts_deg: Sequence[int] = (), tilts_deg: Sequence[int] = ()
) -> list[SurveyRow]:
    """One row for every pose of the grid that the actuators reach and where wrist 2 can level the tool."""
    rows = []
    for lift in lifts_deg or arm.lifts_deg:
        for tilt in tilts_deg or arm.tilts_deg:
            if abs(lift + tilt) <= 85.0:
                try:
                    rows.append(_row(config_dir, arm, float(lift), float(tilt)))
                except ConfigurationError as error:
                    if error.cause not in ("configuration.outside_stroke", "configuration.overload"):
                        raise
    return rows


def _row(config_dir: Path, arm: SurveyedArm, lift: float, tilt: float) -> SurveyRow:
    config = _config(config_dir / arm.file)
    pose = {"start_pose_deg": (0.0, lift, tilt, 0.0, lift + tilt, 0.0)}
    plant = Plant(_changed(config, pose), seed=1)
    X_BT = plant.truth().X_BT
    spectrum = plant.vibrations()
    lowest = min((mode for mode in spectrum if mode.imag > 0.1), key=abs)
    reach = float(np.hypot(X_BT[0, 3], X_BT[1, 3]))
    believed = _tool(_changed(config, RIGID), _readings(plant))
    return SurveyRow(
        arm=arm.name,
        lift_deg=lift,
        tilt_deg=tilt,
        reach_m=reach,
        sag_mm=tuple(_sag(_loaded(_changed(config, pose), mass)) for mass in arm.loads_kg),
        play_mm=config.errors.backlash.half_width_mrad[0] * reach,
        believed_mm=1e3 * float(np.linalg.norm(X_BT[:3, 3] - believed)),
        servo_mm=(_servo_rest(_changed(config, pose), 0.0), _servo_rest(_changed(config, pose), 1.0)),
        lowest_hz=float(abs(lowest)) / (2.0 * math.pi),
        damping=float(-lowest.real / abs(lowest)),
    )


@cache
def _config(path: Path) -> PlantConfig:
    return load(PlantConfig, path)


def _changed(config: PlantConfig, changes: Mapping[str, object]) -> PlantConfig:
    return PlantConfig.model_validate(merged(config.model_dump(), changes))


def _loaded(config: PlantConfig, mass: float) -> PlantConfig:
    """``config`` with ``mass`` (kg) beyond the arm: wrist and payload, or a wrist made lighter."""
    bodies = {name: getattr(config.masses, name).mass_kg for name in ("wrist1", "wrist2", "tool")}
    bare = sum(bodies.values())
    lighter = {name: {"mass_kg": min(mass / bare, 1.0) * own} for name, own in bodies.items()}
    return _changed(config, {"masses": lighter, "payload": {"mass_kg": max(mass - bare, 0.0)}})


def _sag(config: PlantConfig) -> float:
    """How far (mm) the tool hangs below that of a stiff arm, the joints where they are."""
    stiff = _changed(config, {"flexibility": {"enabled": False}})
    bent, straight = (Plant(c, seed=1).truth().X_BT[:3, 3] for c in (config, stiff))
    return 1e3 * float(np.linalg.norm(bent - straight))


def _readings(plant: Plant) -> Array:
    """The joint angles (6,) that the encoders tell (rad)."""
    return np.array(plant.read().encoder_counts) * (2.0 * math.pi / COUNTS_PER_TURN)


def _tool(config: PlantConfig, angles: Array) -> Array:
    """The tool's place (3,) in B at joint ``angles`` by the geometry of ``config``, its hinges straight."""
    model, chain, _ = build_model(config)
    work, q = multibody_work(N_COORDINATES), np.zeros(N_COORDINATES)
    q[list(DRIVEN)] = angles
    forward_kinematics(q, model.mechanism, work)
    return np.asarray(work.rotation[-1] @ chain.X_BT_home[:3, 3] + work.origin[-1])


def _servo_rest(config: PlantConfig, compensation: float) -> float:
    """How far (mm) the measured tool rests from its goal under u = K (q_d - q) from OFF_MRAD off.

    K is SERVO_GAINS over the speed at full spool; ``compensation``: the share of the deadband added to u.
    """
    plant, gain = Plant(config, seed=1), SERVO_GAINS / _full_speeds(config)
    goal = _readings(plant) + OFF_MRAD * 1e-3
    overlap = np.array([np.mean(config.valves.of(name, 1.0).deadband) for name in JOINT_NAMES])
    for k in range(round(SERVO_S / CYCLE_S)):
        u = gain * (goal - _readings(plant))
        u += compensation * overlap * np.clip(u / BLEND, -1.0, 1.0)
        a, b, c, d, e, f = (float(spool) for spool in u)
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, (a, b, c, d, e, f)))
        plant.advance(round(CYCLE_S * 1e9))
    nominal = _changed(config, RIGID)
    return 1e3 * float(np.linalg.norm(_tool(nominal, _readings(plant)) - _tool(nominal, goal)))


def _full_speeds(config: PlantConfig) -> Array:
    """Unloaded joint speeds (6,) at full spool (rad/s) in the raising sense, at the start pose."""
    speeds, drop = [], config.valves.rated_drop_bar * BAR
    rows = build_model(config)[0].actuators
    for actuator, row, angle in zip(config.actuators.in_order(), rows, config.start_pose_deg, strict=True):
        area_a, area_b = actuator.areas()
        push = (area_a * config.pump.pressure_bar - area_b * config.pump.return_bar) * BAR
        gain = orifice_gain(actuator.rated_flow_l_min * LITRE_PER_MINUTE, drop)
        lever = actuator_lever(math.radians(angle), *(float(v) for v in row[:5]))
        speeds.append(gain * math.sqrt(push / (area_a**3 + area_b**3)) / lever)
    return np.array(speeds)
