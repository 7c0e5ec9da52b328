"""Families 16 to 20: oil and energy, what the pump cannot give, encoders, convergence of the integration."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load
from laboratory.validation.ledger import Ledger
from laboratory.validation.plant_rig import NO_ERRORS, Stand, ValidationCase, default_config
from plant_emulator.config.actuators import BAR, LITRE_PER_MINUTE
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.hydraulics.oil_rates import bulk_modulus
from plant_emulator.core.layout import N_ACTUATORS, PRESSURE_A, PRESSURE_B, SUPPLY, Q
from plant_emulator.core.model import put_payload
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage

Array = NDArray[np.float64]

BOTH = slice(PRESSURE_A, PRESSURE_B + N_ACTUATORS)  # bore pressures, then rod pressures


def resting_arm(config_dir: Path, pose_deg: list[float], payload: float, **changes: Any) -> Stand:
    """The whole flexible arm at rest, carrying ``payload`` (kg)."""
    config = default_config(config_dir, {"start_pose_deg": pose_deg}, changes)
    stand = Stand(config, np.radians(pose_deg))
    put_payload(stand.model, stand.tool, payload, config, stand.chain)
    stand.state[:] = rest_state(stand.model, stand.angles, config.oil.temperature_degc)
    return stand


def sudden_stop(config_dir: Path) -> list[ValidationCase]:
    """Family 16: lowering 200 kg at full speed, then the valves shut: pressures and oil masses."""
    stand = resting_arm(config_dir, [0.0, 60.0, -60.0, 0.0, 0.0, 0.0], 200.0)
    ledger, books = Ledger(stand), []
    for opening, seconds in ((-1.0, 0.8), (0.0, 1.5)):
        stand.command[1] = stand.command[2] = opening
        books.append(ledger.run(seconds, 2.5e-4))
    setting = float(stand.model.circuit[col.C_RELIEF]) / BAR
    least = min(balance.least_pressure for balance in books) / BAR
    most = max(balance.greatest_pressure for balance in books) / BAR
    worst = max(balance.mass_error for balance in books)
    return [
        ValidationCase(16, "least absolute pressure", "bar", 0.0, least, 0.0, "oil cannot pull", "at_least"),
        ValidationCase(
            16, "greatest pressure", "bar", 1.1 * setting, most, 0.0, "relief setting + 10 %", "at_most"
        ),
        ValidationCase(16, "oil mass, worst chamber", "", 0.0, worst, 1e-6, "∫ρQ dt = Δ(ρV)"),
    ]


def energy_balance(config_dir: Path) -> list[ValidationCase]:
    """Family 17: what the supply gives against motion, seals, hinges, orifices, return and compressed oil."""
    stand = resting_arm(config_dir, [0.0, 30.0, -70.0, 0.0, -20.0, 0.0], 50.0)
    ledger, given, accounted = Ledger(stand), 0.0, 0.0
    for command in ([0.3, 0.3, 0.25, 0.2, -0.2, 0.3], [-0.3, 0.2, -0.2, -0.2, 0.2, -0.3], [0.0] * 6):
        stand.command[:] = command
        balance = ledger.run(0.7, 5e-4)
        given += balance.given
        accounted += balance.accounted
    return [
        ValidationCase(
            17,
            "energy from the supply accounted for",
            "J",
            given,
            accounted,
            1e-3 * given,
            "Pinocchio, ∫ p Q dt",
        )
    ]


def pump_saturation(config_dir: Path) -> list[ValidationCase]:
    """Family 18: lift and tilt with their valves full open share what the pump can give."""
    stand = resting_arm(config_dir, [0.0, 0.0, -130.0, 0.0, 0.0, 0.0], 0.0)
    stand.command[1] = stand.command[2] = 1.0
    stand.run(0.4, 5e-4)
    supply = float(stand.state[SUPPLY])

    def drawn(s: Stand, state: Array) -> Array:
        c, table, v = s.model.circuit, s.model.actuators, s.work.flows[:, col.F_VELOCITY]
        softness = 1.0 / bulk_modulus(
            state[SUPPLY], c[col.C_LINE_VOLUME], c[col.C_MODULUS], 0.0, *c[[col.C_AIR, col.C_EXPONENT]]
        )
        return np.array([s.work.flows[:, col.F_SUPPLY].sum(), (table[1:3, col.A_AREA_A] @ v[1:3]), softness])

    seconds = 1.5
    volume, seen = stand.run_with_integrals(seconds, 5e-4, drawn, 3)
    stored = float(stand.state[SUPPLY]) - supply
    refilled = stored * volume[2] / seconds * float(stand.model.circuit[col.C_LINE_VOLUME])
    mean = (float(volume[0]) + refilled) / seconds / LITRE_PER_MINUTE
    limit = float(stand.model.circuit[col.C_FLOW_LIMIT]) / LITRE_PER_MINUTE
    ceiling = stand.config.pump.pressure_bar - stand.config.pump.droop_bar
    bores = float(volume[1]) / seconds / LITRE_PER_MINUTE
    return [
        ValidationCase(
            18, "mean flow drawn and stored in the line", "l/min", limit, mean, 2e-3 * limit, "Q_max"
        ),
        ValidationCase(18, "mean displacement of both bores", "l/min", limit, bores, 0.03 * limit, "Q_max"),
        ValidationCase(
            18,
            "supply sags below",
            "bar",
            ceiling,
            float(seen[:, SUPPLY].max()) / BAR,
            0.0,
            "p_set − droop",
            "at_most",
        ),
    ]


LSB = 2.0 * math.pi / COUNTS_PER_TURN
CYCLE_NS = 5_000_000


def encoders(config_dir: Path) -> list[ValidationCase]:
    """Family 19: quantisation, noise, and the loop of a joint that slews to and fro through its play."""
    clean = _sweep(Plant(default_config(config_dir), seed=1))
    rounding = float(np.abs(clean[:, 1] * LSB - clean[:, 0]).max())
    whole = float(np.abs(clean[:, 1] - np.rint(clean[:, 1])).max())
    width = 0.3e-3
    play = {
        "errors": {
            **NO_ERRORS["errors"],
            "backlash": {"enabled": True, "half_width_mrad": [0.3, 0, 0, 0, 0, 0]},
        }
    }
    loose = _sweep(Plant(default_config(config_dir, play), seed=1))
    lag = loose[:, 1] * LSB - loose[:, 0]
    noisy_errors = {"errors": {**NO_ERRORS["errors"], "encoder_noise": {"enabled": True, "rms_lsb": 0.3}}}
    still = Plant(default_config(config_dir, noisy_errors), seed=1)
    dithered = np.array([still.read().encoder_counts for _ in range(4000)]) - still.truth().q / LSB
    error = float(dithered.mean(axis=0)[[1, 2]].std())
    return [
        ValidationCase(19, "reading is a multiple of the LSB", "LSB", 0.0, whole, 0.0, "17 bit to the turn"),
        ValidationCase(
            19, "rounding", "mrad", 0.5 * LSB * 1e3, rounding * 1e3, 1e-9, "half an LSB", "at_most"
        ),
        ValidationCase(
            19,
            "loop of a play of 2 b",
            "mrad",
            2e3 * width,
            1e3 * float(np.ptp(lag)),
            1.05e3 * LSB,
            "2 b + 1 LSB",
        ),
        ValidationCase(
            19, "mean of dithered readings", "LSB", 0.0, error, 0.15, "noise of 0.3 LSB linearises"
        ),
    ]


def _sweep(plant: Plant) -> Array:
    """True slew angle (rad) and encoder count, sampled while the joint goes to and fro."""
    rows = []
    for k in range(600):
        opening = 0.2 * math.sin(2.0 * math.pi * k / 300.0)
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, (opening, 0.0, 0.0, 0.0, 0.0, 0.0)))
        plant.advance(CYCLE_NS)
        rows.append((plant.truth().q[0], plant.read().encoder_counts[0]))
    return np.array(rows)


def convergence(config_dir: Path) -> list[ValidationCase]:
    """Family 20: errors of a smooth motion at three steps, and replay of a seed."""
    ends = {}
    for step in (1e-3, 5e-4, 2.5e-4, 3.125e-5):
        stand = resting_arm(config_dir, [0.0, 30.0, -80.0, 0.0, -20.0, 0.0], 30.0)
        stand.command[:] = 0.25, 0.3, 0.25, 0.2, 0.2, 0.2
        stand.run(0.3, 3.125e-5)  # past break-away, where friction is not smooth
        stand.run(0.4, step)
        ends[step] = stand.state[Q : Q + 10].copy()
    errors = [float(np.linalg.norm(ends[step] - ends[3.125e-5])) for step in (1e-3, 5e-4, 2.5e-4)]
    first, again, other = _words(config_dir, 7), _words(config_dir, 7), _words(config_dir, 8)
    return [
        ValidationCase(
            20, "error ratio of 1 ms to 0.5 ms", "", 16.0, errors[0] / errors[1], 1.0, "fourth order"
        ),
        ValidationCase(
            20, "error ratio of 0.5 ms to 0.25 ms", "", 16.0, errors[1] / errors[2], 1.0, "fourth order"
        ),
        ValidationCase(20, "replay of a seed", "differences", 0.0, float(first != again), 0.0, "bit for bit"),
        ValidationCase(20, "another seed differs", "", 1.0, float(first != other), 0.0, "encoder noise"),
    ]


def _words(config_dir: Path, seed: int) -> bytes:
    """Every bit that a plant reports in one second of random valve commands."""
    plant = Plant(load(PlantConfig, config_dir / "plant.yaml"), seed)
    rng = np.random.default_rng(20)
    seen = []
    for k in range(200):
        command = rng.uniform(-0.5, 0.5, 6)
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, tuple(float(u) for u in command)))  # type: ignore[arg-type]
        plant.advance(CYCLE_NS)
        image, truth = plant.read(), plant.truth()
        seen += [*image.encoder_counts, *truth.X_WT.ravel(), *truth.pressures.ravel()]
    return np.array(seen, dtype=float).tobytes()
