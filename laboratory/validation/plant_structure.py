"""Families 21 to 24: beams of several hinges, twist, a base that rocks, the whole chain against oracles."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laboratory.validation.ledger import MujocoArm, PinocchioArm
from laboratory.validation.plant_dynamics import decrement, period
from laboratory.validation.plant_rig import Stand, ValidationCase, default_config
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import bent_pose
from plant_emulator.core.mechanics import loose
from plant_emulator.core.mechanics.bodies import sphere
from plant_emulator.core.mechanics.elastic import outboard_inertia
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work

Array = NDArray[np.float64]

START = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
NEWTONS = 1000.0
ALL_THAT_MOVES = (
    "finer_bending", "torsion", "pin_compliance", "bearing_tilt", "loose_slew", "rocking_base"
)  # fmt: skip


def switched_on(*names: str, **changes: Mapping[str, Any]) -> dict[str, Any]:
    """The errors of these ``names`` on, with ``changes`` of their numbers."""
    return {"errors": {name: {"enabled": True, **changes.get(name, {})} for name in {*names, *changes}}}


def several_hinges(config_dir: Path) -> list[ValidationCase]:
    """Family 21: tip deflection and slope of beams of two and three hinges, against Euler and Bernoulli."""
    cases, level = [], np.zeros(6)
    for places in ([0.25, 0.6], [0.28, 0.6], [0.2, 0.5, 0.8]):
        finer = {"boom_at": places, "arm_at": places}
        stand = Stand(default_config(config_dir, switched_on(finer_bending=finer)), level)
        for link, pivot in (("boom", "lift"), ("arm", "tilt")):
            drop, slope = _bent_tip(stand, link, pivot)
            beam = getattr(stand.config.flexibility, link)
            expected = NEWTONS * beam.length_m**3 / (3.0 * beam.vertical_ei_n_m2) * 1e3
            turned = NEWTONS * beam.length_m**2 / (2.0 * beam.vertical_ei_n_m2) * 1e3
            name = f"{link} of {len(places)} hinges from {places[0]:g}"
            cases.append(
                ValidationCase(
                    21, f"{name}, tip under 1 kN", "mm", expected, drop, 2e-3 * expected, "P L³ / 3 EI"
                )
            )
            cases.append(
                ValidationCase(21, f"{name}, slope", "mrad", turned, slope, 0.002 * turned, "P L² / 2 EI")
            )
    return cases


def _bent_tip(stand: Stand, link: str, pivot: str) -> tuple[float, float]:
    """How far (mm) and by what angle (mrad) the tip of ``link``, laid level, goes down under 1 kN there."""
    names = stand.chain.names
    vertical = [i for i, name in enumerate(names) if name.startswith(f"{link}_vertical")]
    root, config = stand.chain.point[stand.at(pivot)], stand.config
    end = stand.chain.point[stand.at("tilt" if link == "boom" else "wrist1")]
    tip = root + (end - root) * (getattr(config.flexibility, link).length_m / np.linalg.norm(end - root))
    q = stand.angles
    q[:] = 0.0
    q[stand.at(pivot)] = -math.atan2(tip[2] - root[2], tip[0] - root[0])
    lying = Stand(config)
    lying.unload(*range(len(q)))
    lying.model.mechanism.free[:] = 0.0
    lying.model.mechanism.free[vertical] = 1.0
    lying.hang(vertical[-1] + 1, [sphere(NEWTONS / config.gravity_m_s2, tip, 0.0)])
    lying.state[lying.model.places.angle] = q
    before = lying.place(vertical[-1] + 1, tip)
    bent = bent_pose(lying.model, q)
    lying.state[lying.model.places.angle] = bent
    drop = float(before[2] - lying.place(vertical[-1] + 1, tip)[2])
    return drop * 1e3, -float(bent[vertical].sum()) * 1e3


def twist(config_dir: Path) -> list[ValidationCase]:
    """Family 22: both links under a load beside their axis, alone and on their pins."""
    cases = []
    for entries, on, source in (
        (("torsion",), "alone", "m g y L / GJ"),
        (("torsion", "pin_compliance"), "on its pin", "m g y (L / GJ + 1 / K)"),
    ):
        stand = Stand(default_config(config_dir, switched_on(*entries)), np.zeros(6))
        errors, bend = stand.config.errors, stand.config.flexibility
        for link, beam, gj, pin in (
            ("boom", bend.boom, errors.torsion.boom_gj_n_m2, errors.pin_compliance.lift_nm_rad),
            ("arm", bend.arm, errors.torsion.arm_gj_n_m2, errors.pin_compliance.tilt_nm_rad),
        ):
            at, side = stand.at(f"{link}_twist"), 0.3
            axis, root = stand.chain.axis[at], stand.chain.point[at]
            q = stand.angles
            q[stand.at("lift" if link == "boom" else "tilt")] = -math.atan2(axis[2], axis[0])
            stand.unload(*range(len(q)))
            stand.clamp_all_but(at)
            stand.hang(at, [sphere(100.0, root + axis + np.array([0.0, -side, 0.0]), 0.0)])
            torque = 100.0 * stand.config.gravity_m_s2 * side
            expected = torque * (beam.length_m / gj + (1.0 / pin if len(entries) == 2 else 0.0)) * 1e3
            obtained = float(bent_pose(stand.model, q)[at]) * 1e3
            cases.append(
                ValidationCase(
                    22, f"{link} {on}, 100 kg 0.3 m aside", "mrad", expected, obtained, 3e-4, source
                )
            )  # fmt: skip
    return cases


def rocking(config_dir: Path) -> list[ValidationCase]:
    """Family 23: each way the base rocks alone: frequency and decay; and how an engine shakes it."""
    cases = []
    for k, name in enumerate(("base_roll", "base_pitch", "base_yaw")):
        config = default_config(config_dir, {"gravity_m_s2": 0.0}, switched_on("rocking_base"))
        stand, base, step = Stand(config, START), config.errors.rocking_base, 5e-4
        at = stand.at(name)
        stand.clamp_all_but(at)
        expected, zeta = base.frequency_hz[k], base.damping_ratio
        stand.state[stand.model.places.angle[at]] = 1e-3
        seen = np.array(stand.run(12.0 / expected, step, lambda s, at=at: float(s.angles[at])))  # type: ignore[misc]
        damped = expected * math.sqrt(1.0 - zeta * zeta)
        expected = 2.0 * math.pi * zeta / math.sqrt(1.0 - zeta * zeta)
        cases.append(
            ValidationCase(
                23, f"{name} let go", "Hz", damped, 1.0 / period(step, seen), 0.002 * damped, "frequency_hz"
            )
        )
        cases.append(
            ValidationCase(
                23, f"{name} log decrement", "", expected, decrement(seen), 0.01 * expected, "2πζ/√(1 − ζ²)"
            )
        )
    cases.append(_shaken(config_dir))
    return cases


def _shaken(config_dir: Path) -> ValidationCase:
    """The roll that an engine of 20 Hz keeps up, of a base that only rolls."""
    engine = {"frequency_hz": 20.0, "moment_nm": [1000.0, 0.0, 0.0]}
    still = {"frequency_hz": 20.0, "moment_nm": [0.0, 0.0, 0.0]}
    shake = switched_on("rocking_base", vibration={"engine": engine, "pump": still})
    shake["errors"]["rocking_base"]["damping_ratio"] = 0.2
    config = default_config(config_dir, {"gravity_m_s2": 0.0}, shake)
    stand = Stand(config, START)
    at = stand.at("base_roll")
    stand.clamp_all_but(at)
    inertia = outboard_inertia(stand.model.mechanism, stand.angles, at)
    stand.run(4.0, 5e-4)
    seen = np.array(stand.run(1.0, 5e-4, lambda s: float(s.angles[at])))
    own, driven = 2.0 * math.pi * config.errors.rocking_base.frequency_hz[0], 2.0 * math.pi * 20.0
    lag = complex(own * own - driven * driven, 2.0 * 0.2 * own * driven)
    expected = 1000.0 / (inertia * abs(lag)) * 1e3
    return ValidationCase(
        23, "roll under an engine of 20 Hz", "mrad", expected, 0.5e3 * float(np.ptp(seen)), 0.005 * expected,
        "M / J |ω0² − ω² + 2iζω0ω|",
    )  # fmt: skip


def whole_chain(config_dir: Path) -> list[ValidationCase]:
    """Family 24: everything at once: accelerations by two oracles, energy of a fall without damping."""
    stand = Stand(default_config(config_dir, switched_on(*ALL_THAT_MOVES)), START)
    mech, n = stand.model.mechanism, len(stand.chain.names)
    arms = (("MuJoCo", MujocoArm(mech)), ("Pinocchio", PinocchioArm(mech)))
    worst, rng = {name: 0.0 for name, _ in arms}, np.random.default_rng(24)
    own, work, joints = np.zeros(n), multibody_work(n), stand.model.places.joint
    for _ in range(100):
        q = rng.uniform(-0.02, 0.02, n)
        q[joints] = np.array([0.0, 0.8, -1.4, 0.0, 0.0, 0.0]) + rng.uniform(-1.0, 1.0, 6)
        rate, force = rng.normal(0.0, 0.5, n), rng.normal(0.0, 30.0, n)
        forward_dynamics(q, rate, force, mech, work, own)
        for name, arm in arms:
            difference = np.abs(arm.acceleration(q, rate, force) - own) / np.maximum(1.0, np.abs(own))
            worst[name] = max(worst[name], float(difference.max()))
    cases = [
        ValidationCase(24, f"accelerations of {n} coordinates against {name}", "", 0.0, value, 1e-9,
                       f"{name}, 100 random states, relative")
        for name, value in worst.items()
    ]  # fmt: skip
    drift = _energy_drift(stand)
    source = "conservation; of the largest kinetic energy, by Pinocchio and the springs"
    return [*cases, ValidationCase(24, "energy drift in 2 s of free fall", "", 0.0, drift, 1e-4, source)]


def _energy_drift(stand: Stand) -> float:
    """How far energy drifts in a fall of the whole chain, flanks meeting, relative to the kinetic energy."""
    mech, model = stand.model.mechanism, stand.model
    mech.damping[:] = 0.0
    model.loose.shared[:, 2] = 0.0
    mesh, tilt = model.loose.mesh, model.loose.tilt
    mesh[[loose.M_DAMPING, loose.M_COULOMB, loose.M_STATIC, loose.M_BRISTLE_DAMPING, loose.M_VISCOUS]] = 0.0
    tilt[loose.T_DAMPING] = 0.0
    stand.smooth(*range(6))
    stand.model.actuators[:, [col.A_AREA_A, col.A_AREA_B, col.A_STOP_STIFFNESS, col.A_STOP_DAMPING]] = 0.0
    oracle = PinocchioArm(mech)
    slew, play, ring = stand.at("slew"), int(mesh[loose.M_AT]), int(tilt[loose.T_AT])

    def energy(s: Stand) -> tuple[float, float]:
        q = s.angles
        kinetic, gravity = oracle.energies(q, s.state[model.places.rate])
        springs = 0.5 * float(mech.stiffness @ (q * q))
        turned = q[slew] + q[play]
        hoses = 0.5 * mesh[loose.M_HOSE_SPRING] * turned**2 - mesh[loose.M_HOSE] * turned
        pressed = max(abs(q[play]) - mesh[loose.M_HALF], 0.0)
        leant = max(math.hypot(q[ring], q[ring + 1]) - tilt[loose.T_HALF], 0.0)
        flanks = 0.5 * mesh[loose.M_STIFFNESS] * pressed**2 + 0.5 * tilt[loose.T_STIFFNESS] * leant**2
        return kinetic, kinetic + gravity + springs + hoses + float(flanks)

    seen = np.array(stand.run(2.0, 5e-5, energy))
    return float(np.abs(seen[:, 1] - seen[0, 1]).max() / seen[:, 0].max())
