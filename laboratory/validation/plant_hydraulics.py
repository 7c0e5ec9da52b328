"""Families 6 to 9 and 15: orifice, spool, free velocities, blocked piston, leakage."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laboratory.validation.plant_balances import resting_arm
from laboratory.validation.plant_rig import (
    LIFT,
    STAND,
    Stand,
    ValidationCase,
    bare_cylinder,
    default_config,
    loaded_lift,
    rate_of,
)
from laboratory.validation.plant_statics import settle_lift
from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import gravity_torque
from plant_emulator.core.hydraulics.valve_commands import orifice_flow, spool_acceleration
from plant_emulator.core.layout import DRIVEN, N_COORDINATES, PRESSURE_A, PRESSURE_B, SPOOL, Q

Array = NDArray[np.float64]
WRIST2_VALVE = 4  # its row in the actuator table


def orifice(config_dir: Path) -> list[ValidationCase]:
    """Family 6: rated flow, oddness and monotony of the valve's edge."""
    stand = Stand(default_config(config_dir))
    gain, soft = float(stand.model.actuators[1, col.A_GAIN]), float(stand.model.circuit[col.C_REGULARISATION])
    rated = orifice_flow(gain, 35.0 * BAR, soft) / LITRE_PER_MINUTE
    drops = np.linspace(-200.0 * BAR, 200.0 * BAR, 4001)
    flows = np.array([orifice_flow(gain, drop, soft) for drop in drops])
    uneven = float(np.abs(flows + flows[::-1]).max())
    return [
        ValidationCase(6, "flow at 35 bar", "l/min", 100.0, float(rated), 0.1, "rating"),
        ValidationCase(6, "orifice gain", "m³/s/√Pa", 8.909e-7, gain, 1e-10, "100 l/min at 35 bar"),
        ValidationCase(6, "oddness", "m³/s", 0.0, uneven, 1e-18, "symmetry"),
        ValidationCase(
            6,
            "least rise over 0.1 bar",
            "m³/s",
            0.0,
            float(np.diff(flows).min()),
            0.0,
            "monotony",
            "at_least",
        ),
    ]


def _spool_response(stand: Stand, command: Array, h: float) -> Array:
    """Spool positions under a sampled ``command``, by the plant's spool equation and Runge-Kutta."""
    omega, zeta = float(stand.model.actuators[1, col.A_OMEGA]), float(stand.model.actuators[1, col.A_ZETA])
    x, v, seen = 0.0, 0.0, []
    for k in range(len(command) - 2):
        seen.append(x)
        middle = 0.5 * (command[k] + command[k + 1])
        a1 = spool_acceleration(command[k], x, v, omega, zeta)
        a2 = spool_acceleration(middle, x + 0.5 * h * v, v + 0.5 * h * a1, omega, zeta)
        a3 = spool_acceleration(middle, x + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, omega, zeta)
        a4 = spool_acceleration(command[k + 1], x + h * v + 0.5 * h * h * a2, v + h * a3, omega, zeta)
        x, v = x + h * v + h * h / 6.0 * (a1 + a2 + a3), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    return np.array(seen)


def spool(config_dir: Path) -> list[ValidationCase]:
    """Family 7: step of the whole plant's spool below its slew limit, and a sine at its bandwidth."""
    stand = bare_cylinder(config_dir)
    stand.command[STAND] = 0.1
    step = 1e-4
    seen = np.array(stand.run(0.06, step, lambda s: float(s.state[SPOOL + STAND]))) / 0.1
    top = int(seen.argmax())
    left, peak, right = seen[top - 1 : top + 2]
    when = (top + 0.5 * (left - right) / (left - 2.0 * peak + right)) * step
    overshoot = (peak - 1.0) * 100.0
    h, frequency = 1e-4, 30.0
    times = np.arange(0, 1.0, h)
    answer = _spool_response(stand, np.sin(2.0 * math.pi * frequency * times), h)
    tail = slice(len(answer) - round(0.5 / h), len(answer))
    phasor = 2.0 * np.mean(answer[tail] * np.exp(-2j * math.pi * frequency * times[: len(answer)][tail])) * 1j
    return [
        ValidationCase(7, "overshoot of a step", "%", 4.33, float(overshoot), 0.02, "exp(−πζ/√(1 − ζ²))"),
        ValidationCase(7, "time of the peak", "ms", 23.6, float(when) * 1e3, 0.05, "π / (ω √(1 − ζ²))"),
        ValidationCase(7, "gain at 30 Hz", "dB", -3.01, 20.0 * math.log10(abs(phasor)), 0.02, "1 / 2ζ"),
        ValidationCase(7, "phase at 30 Hz", "°", -90.0, math.degrees(np.angle(phasor)), 0.1, "second order"),
    ]


def _free_run(config_dir: Path, opening: float, load: float) -> Stand:
    """The bare cylinder in steady motion against a dry friction of ``load`` (N)."""
    stand = bare_cylinder(config_dir)
    row = stand.model.actuators[STAND]
    row[[col.A_COULOMB, col.A_STATIC]] = load
    row[[col.A_BRISTLE, col.A_BRISTLE_DAMPING]] = 1e6, 1e4
    stand.state[Q] = 0.5 if opening > 0.0 else 4.0
    stand.command[STAND] = opening
    stand.run(3.0, 5e-4)
    stand.rates()
    return stand


def free_velocity(config_dir: Path) -> list[ValidationCase]:
    """Family 8: steady velocities and pressures of a cylinder between ideal supply and return."""
    cases = []
    for load, speed, back in ((0.0, 0.660, 0.534), (54.7e3, 0.421, None)):
        stand = _free_run(config_dir, 1.0, load)
        label = f"F = {load / 1e3:g} kN"
        cases.append(
            ValidationCase(
                8, f"extension, {label}", "m/s", speed, rate_of(stand), 6e-4, "flow and force balance"
            )
        )
        if load > 0.0:
            p_a, p_b = (float(stand.state[i + STAND]) / BAR for i in (PRESSURE_A, PRESSURE_B))
            cases.append(
                ValidationCase(8, f"bore pressure, {label}", "bar", 133.7, p_a, 0.2, "flow and force balance")
            )
            cases.append(
                ValidationCase(8, f"rod pressure, {label}", "bar", 36.3, p_b, 0.2, "flow and force balance")
            )
        if back is not None:
            pulled = _free_run(config_dir, -1.0, load)
            cases.append(
                ValidationCase(
                    8, f"retraction, {label}", "m/s", -back, rate_of(pulled), 6e-4, "flow and force balance"
                )
            )
    cases.append(_pulled_in(config_dir))
    return cases


def _pulled_in(config_dir: Path) -> ValidationCase:
    """Retraction with a load of 54.7 kN helping: the force of a long, soft spring."""
    stand = bare_cylinder(config_dir)
    mech = stand.model.mechanism
    stiffness, far = 0.1, 54.7e4
    mech.stiffness[0] = stiffness
    stand.state[Q] = far
    row = stand.model.actuators[STAND]
    row[col.A_ANGLE0] = far - 4.0
    stand.command[STAND] = -1.0
    stand.run(3.0, 5e-4)
    return ValidationCase(
        8, "retraction, F = 54.7 kN", "m/s", -0.738, rate_of(stand), 6e-4, "flow and force balance"
    )


def blocked_piston(config_dir: Path) -> list[ValidationCase]:
    """Family 9: pressure build-up in front of a blocked piston, without and with entrained air."""
    cases = []
    for air in (0.0, 0.005):
        stand = bare_cylinder(config_dir)
        stand.clamp_all_but()
        stand.model.circuit[col.C_AIR] = air
        stand.state[SPOOL + STAND] = stand.command[STAND] = 0.2
        stand.state[PRESSURE_A + STAND] = 60.0 * BAR
        row, rate = stand.model.actuators[STAND], stand.rates()
        flow = 0.2 * float(row[col.A_GAIN]) * math.sqrt(130.0 * BAR)
        volume = 3e-3 + float(row[col.A_AREA_A]) * 0.3
        n, p = 1.2, 60.0 * BAR
        softness = 1.0 / 800e6 + air * (101325.0 / p) ** (1.0 / n) / (n * p)
        expected = flow / volume / softness / BAR
        label = "with air" if air else "oil alone"
        obtained = float(rate[PRESSURE_A + STAND]) / BAR
        cases.append(
            ValidationCase(9, f"build-up, {label}", "bar/s", expected, obtained, 1e-6 * expected, "β Q / V")
        )
    return cases


def _level_angle(stand: Stand) -> float:
    """The lift angle (rad) at which gravity's torque is greatest: the load level with the pivot."""
    angles, q = np.linspace(0.0, 1.5, 1501), stand.state[Q : Q + N_COORDINATES].copy()
    torques = []
    for angle in angles:
        q[LIFT] = angle
        torques.append(-gravity_torque(stand.model.mechanism, q)[LIFT])
    return float(angles[int(np.argmax(torques))])


def leakage_creep(config_dir: Path) -> list[ValidationCase]:
    """Family 15: a shut actuator of equal areas creeps under its load at Q_L / A."""
    stand = loaded_lift(config_dir)
    stand.clamp_all_but(LIFT)
    stand.smooth(1)
    row, lever = stand.model.actuators[1], 0.3
    row[col.A_KIND], row[col.A_ANGLE0], row[col.A_STROKE] = 1.0, -math.pi, 2.0 * math.pi
    row[[col.A_AREA_A, col.A_AREA_B]] = 5.0265e-3 * lever
    row[col.A_LEAKAGE] = 1e-12
    stand.state[Q + LIFT] = (
        _level_angle(stand) + 0.12
    )  # where the load's torque hardly changes with the angle
    settle_lift(stand)
    row[col.A_VISCOUS] = 2e3  # stills the swing on the oil; carries a thousandth of the load
    seen = stand.run(20.0, 1e-3, lambda s: float(s.state[Q + LIFT]))
    torque = -gravity_torque(stand.model.mechanism, stand.state[Q : Q + N_COORDINATES])[LIFT]
    expected = -1e-12 * torque / float(row[col.A_AREA_A]) ** 2
    obtained = (seen[-1] - seen[len(seen) // 2]) / 10.0
    ratio = (
        float(stand.state[PRESSURE_A + 1] - stand.state[PRESSURE_B + 1]) * float(row[col.A_AREA_A]) / torque
    )
    return [
        ValidationCase(
            15, "creep of a shut actuator", "rad/s", expected, obtained, 0.01 * abs(expected), "Q_L / A"
        ),
        ValidationCase(15, "oil carries the load", "", 1.0, ratio, 0.001, "force balance"),
        *_held_wrist(config_dir),
    ]


def _held_wrist(config_dir: Path) -> list[ValidationCase]:
    """Wrist 2 shut with 100 kg: what piston and valve let through."""
    actuator, wrist2, cases = WRIST2_VALVE, DRIVEN[WRIST2_VALVE], []
    for label, changes in (("mobile valves", {"valve_set": "mobile"}), ("servo valves", {})):
        stand = resting_arm(config_dir, [0.0, 45.0, -60.0, 0.0, 0.0, 0.0], 100.0, **changes)
        stand.clamp_all_but(wrist2)
        row = stand.model.actuators[actuator]
        row[[col.A_COULOMB, col.A_STATIC, col.A_BRISTLE_DAMPING]] = 0.0
        leaks = float(row[col.A_LEAKAGE] + row[col.A_SPOOL_LEAKAGE])
        torque = gravity_torque(stand.model.mechanism, stand.state[Q : Q + N_COORDINATES])[wrist2]
        back, area = float(stand.model.circuit[col.C_RETURN]), float(row[col.A_AREA_A])
        high, low = (PRESSURE_B, PRESSURE_A) if torque > 0.0 else (PRESSURE_A, PRESSURE_B)
        stand.state[high + actuator], stand.state[low + actuator] = back + abs(torque) / area, back
        row[col.A_VISCOUS] = 200.0  # stills the swing on the oil; carries next to nothing of the load
        turned = stand.run(20.0, 5e-4, lambda s: float(s.state[Q + wrist2]))
        obtained = (turned[-1] - turned[len(turned) // 2]) / 10.0
        expected = leaks * torque / area**2
        cases.append(
            ValidationCase(
                15, f"wrist 2 shut, {label}", "rad/s", expected, obtained, 0.02 * abs(expected), "ΣC Δp / A"
            )
        )
    return cases
