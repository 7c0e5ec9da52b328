"""Families 25 to 27: the loose slew, the ring that tilts, encoders off the centre of their shafts."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laboratory.validation.plant_rig import Stand, ValidationCase, default_config
from laboratory.validation.plant_structure import START, switched_on
from plant_emulator.core.equilibrium import bent_pose, standing_torque
from plant_emulator.core.mechanics import loose
from plant_emulator.core.mechanics.bodies import Lump
from plant_emulator.core.mechanics.elastic import outboard_inertia
from plant_emulator.core.plant import Plant

Array = NDArray[np.float64]

WIDTH_MRAD = 1.6
STEP = 5e-4
HELD = {"coulomb_nm": 20.0, "static_nm": 25.0}
RUBBED = {"coulomb_nm": 200.0, "static_nm": 200.0}  # more than inertia: the boom does not coast
SMOOTH = {"coulomb_nm": 0.0, "static_nm": 0.0, "bristle_damping_nm_s_rad": 0.0, "viscous_nm_s_rad": 0.0}


def loose_slew(config_dir: Path) -> list[ValidationCase]:
    """Family 25: the width of the play, the flank that a side load chooses, friction, what comes back."""
    stand = _turntable(config_dir, 0.0)
    stiffness = float(stand.model.loose.mesh[loose.M_STIFFNESS])
    cases = []
    for pull in (60.0, -60.0):
        pulled = _turntable(config_dir, pull)
        place = 1e3 * float(pulled.run(3.0, STEP, _play)[-1])
        expected = math.copysign(0.5 * WIDTH_MRAD, pull) + 1e3 * pull / stiffness
        source = "b + τ / K; friction holds up to 20 N m of it"
        cases.append(ValidationCase(25, f"flank under {pull:+g} N m", "mrad", expected, place, 0.012, source))
    held = 1e3 * abs(float(_turntable(config_dir, 10.0).run(3.0, STEP, _play)[-1]))
    source = "it sticks: τ / σ0 and some creep"
    cases.append(ValidationCase(25, "10 N m against 20 N m", "mrad", 0.1, held, 0.0, source, "at_most"))
    cases.append(_loop(config_dir))
    cases += _meeting(config_dir)
    return cases


def _turntable(config_dir: Path, pull: float, friction: Mapping[str, float] = HELD) -> Stand:
    """The arm as one rigid body on the loose slew, without gravity, the motor side held."""
    entry = {"backlash_mrad": WIDTH_MRAD, "hose_nm": pull, "hose_nm_rad": 0.0, "friction": friction}
    change = switched_on(loose_slew=entry)
    stand = Stand(default_config(config_dir, {"gravity_m_s2": 0.0}, change), START)
    stand.clamp_all_but(stand.at("slew_play"))
    return stand


def _play(stand: Stand) -> float:
    return float(stand.angles[stand.at("slew_play")])


def _loop(config_dir: Path) -> ValidationCase:
    """How far the boom lags behind a motor side that is led to and fro: the whole play, and the flanks."""
    stand, lag = _turntable(config_dir, 0.0, RUBBED), []
    slew = stand.model.places.angle[stand.at("slew")]
    turn = stand.model.places.rate[stand.at("slew")]
    for k in range(round(8.0 / STEP)):
        phase = 2.0 * math.pi * k * STEP / 4.0
        stand.state[slew], stand.state[turn] = 0.02 * math.sin(phase), 0.02 * math.pi / 2.0 * math.cos(phase)
        stand.run(STEP, STEP)
        lag.append(_play(stand))
    settled = 1e3 * np.array(lag[len(lag) // 2 :])
    width = float(np.median(settled[settled > 0.0]) - np.median(settled[settled < 0.0]))
    pressed = 2e3 * RUBBED["coulomb_nm"] / float(stand.model.loose.mesh[loose.M_STIFFNESS])
    source = "the play; friction, less inertia, presses both flanks in"
    return ValidationCase(25, "loop of a play of 1.6 mrad", "mrad", WIDTH_MRAD + pressed, width, 0.05, source)


def _meeting(config_dir: Path) -> list[ValidationCase]:
    """A boom that flies through its play without friction: what comes back of its speed from a flank."""
    speed, cases = 0.02, []
    for ratio in (0.0, 0.05):
        stand = _turntable(config_dir, 0.0, SMOOTH)
        mesh, play = stand.model.loose.mesh, stand.at("slew_play")
        inertia = outboard_inertia(stand.model.mechanism, stand.angles, play)
        mesh[loose.M_DAMPING] = 2.0 * ratio * math.sqrt(mesh[loose.M_STIFFNESS] * inertia)
        at = stand.model.places.rate[play]
        stand.state[at] = speed
        seen = np.array(stand.run(0.2, 1e-4, partial(_state, at)))
        expected = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio * ratio))
        cases.append(
            ValidationCase(25, f"speed back from a flank, damping {ratio:g}", "", expected,
                           -float(seen.min()) / speed, 0.03, "exp(−πζ/√(1 − ζ²)); it never pulls")
        )  # fmt: skip
    return cases


def _state(at: int, stand: Stand) -> float:
    return float(stand.state[at])


def tilting_ring(config_dir: Path) -> list[ValidationCase]:
    """Family 26: the ring leans by its play and its spring, towards the moment."""
    change = switched_on("bearing_tilt")
    stand = Stand(default_config(config_dir, change), START)
    ring, at = stand.config.errors.bearing_tilt, stand.at("ring_roll")
    free = 0.5 * ring.play_mm / ring.diameter_m
    bent = bent_pose(stand.model, stand.angles)
    moment = standing_torque(stand.model, bent)[[at, at + 1]]
    expected = free + 1e3 * float(np.linalg.norm(moment)) / ring.stiffness_nm_rad
    leant = 1e3 * float(np.hypot(*bent[[at, at + 1]]))
    cases = [
        ValidationCase(26, "lean of the start pose", "mrad", expected, leant, 1e-6, "play / 2 D + M / K"),
        ValidationCase(26, "it leans forward", "mrad", expected, 1e3 * float(bent[at + 1]), 0.02, "gravity"),
    ]
    for name, axis in (("roll", 0), ("pitch", 1)):
        cases.append(_stands(config_dir, name, axis))
    return cases


def _stands(config_dir: Path, name: str, axis: int) -> ValidationCase:
    """Where the ring settles in motion under 2 kN m about one axis, the arm a rigid body without gravity."""
    change = switched_on(bearing_tilt={"damping_nm_s_rad": 1.0e5})
    stand = Stand(default_config(config_dir, {"gravity_m_s2": 0.0}, change), START)
    at = stand.at("ring_roll")
    stand.clamp_all_but(at, at + 1)
    ring, place = stand.config.errors.bearing_tilt, stand.model.places
    weight = [0.0, 0.0, -9.81]
    arm = np.array([2.0, 0.0]) if axis else np.array([0.0, -2.0])
    stand.unload(*range(len(stand.angles)))
    load = 2000.0 / (2.0 * 9.81)
    centre = np.array([arm[0], arm[1], ring.height_m])
    stand.hang(at + 1, [Lump(load, centre, 200.0 * np.eye(3))])
    stand.model.mechanism.gravity[:] = weight
    stand.run(3.0, STEP)
    expected = 0.5 * ring.play_mm / ring.diameter_m + 2e6 / ring.stiffness_nm_rad
    return ValidationCase(
        26, f"{name} under 2 kN m", "mrad", expected, 1e3 * float(stand.state[place.angle[at + axis]]),
        0.01, "play / 2 D + M / K",
    )  # fmt: skip


def eccentric_encoders(config_dir: Path) -> list[ValidationCase]:
    """Family 27: what each encoder reads too much over a turn: amplitude and phase of its first harmonic."""
    cases, turn = [], np.radians(np.arange(0.0, 360.0, 2.0))
    plant = Plant(default_config(config_dir, switched_on("encoder_eccentricity")), seed=1)
    entry = plant.config.errors.encoder_eccentricity
    read = np.array([plant._encoders.read(np.full(6, angle), np.zeros(6)) for angle in turn])
    off = read * (2.0 * math.pi / 131072.0) - turn[:, None]
    first = 2.0 / len(turn) * (np.exp(-1j * turn) @ off) * 1j
    for k, joint in enumerate(("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")):
        cases.append(
            ValidationCase(27, f"{joint} off once a turn", "mrad", entry.mrad[k], 1e3 * abs(first[k]), 0.01,
                           "amplitude in plant.yaml")
        )  # fmt: skip
    turned = np.angle(first * np.exp(-1j * np.radians(entry.phase_deg)), deg=True)
    worst = float(np.abs(turned).max())
    return [*cases, ValidationCase(27, "phase, worst of six", "°", 0.0, worst, 2.0, "phase in plant.yaml")]
