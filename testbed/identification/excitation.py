"""Valve words over time that move an arm for identification: ramps, steps and small mixtures in turn.

A ramp crosses the dead zone slowly, both ways; steps show oil spring and flow; a mixture of small steps on
several joints shows friction, coupling and bending. All go as far one way as the other.
"""

from typing import Literal, NamedTuple

import numpy as np

from foundation.configuration import configuration_hash
from plant_emulator.config.actuators import BAR
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import JOINTS, N_ACTUATORS
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import COUNTS_PER_RADIAN
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.identification.checks import Machine
from testbed.identification.recording import About, Array, MotionRecording, hex_hash

Kind = Literal["rest", "ramp", "step", "mixture"]


class Piece(NamedTuple):
    """A few seconds of excitation: ``amplitude`` of the valve word on ``joints`` (none: at rest)."""

    kind: Kind
    joints: tuple[int, ...]
    amplitude: float
    seconds: float
    seed: int = 0

    @property
    def name(self) -> str:
        """Such as ``ramp of lift, 4 %, 2 s``."""
        who = " and ".join(JOINTS[j] for j in self.joints) or "all"
        return f"{self.kind} of {who}, {100.0 * self.amplitude:.3g} %, {self.seconds:.3g} s"


def words(pieces: list[Piece], period_s: float) -> Array:
    """The valve words (n, 6) of ``pieces`` in turn, one every ``period_s``."""
    return np.concatenate([_words(piece, period_s) for piece in pieces])


def seconds(pieces: list[Piece]) -> float:
    """How long ``pieces`` last together."""
    return sum(piece.seconds for piece in pieces)


def _words(piece: Piece, period_s: float) -> Array:
    n = round(piece.seconds / period_s)
    table, phase = np.zeros((n, N_ACTUATORS)), np.arange(n) / n
    for place, joint in enumerate(piece.joints):
        if piece.kind == "ramp":
            shape = 1.0 - np.abs(4.0 * ((phase + 0.25) % 1.0) - 2.0)
        elif piece.kind == "step":
            shape = np.select([phase < 0.3, phase < 0.5, phase < 0.8], [1.0, 0.0, -1.0], 0.0)
        elif piece.kind == "mixture":
            shape = _mixture(n, period_s, np.random.default_rng([piece.seed, joint, place]))
        else:
            shape = np.zeros(n)
        table[:, joint] = piece.amplitude * shape
    return table


def _mixture(n: int, period_s: float, rng: np.random.Generator) -> Array:
    """Levels of random height, each held 0.08 to 0.4 s, with a sum of zero: the joint ends where it began."""
    shape, k = np.zeros(n), 0
    while k < n:
        held = round(float(rng.uniform(0.08, 0.4)) / period_s)
        level = float(rng.uniform(0.3, 1.0)) * (1.0 if rng.random() < 0.5 else -1.0)
        shape[k : k + held] = 0.0 if rng.random() < 0.2 else level
        k += held
    moving = shape != 0.0
    total, size = float(shape.sum()), float(np.abs(shape).sum())
    if 0.0 < abs(total) < size:  # the stronger side is weakened until both balance
        strong = moving & (np.sign(shape) == np.sign(total))
        shape[strong] *= (size - abs(total)) / (size + abs(total))
    return shape


def standard(deadband: float, joints: tuple[int, ...] = (0, 1, 2), seed: int = 1) -> list[Piece]:
    """The usual excitation of valves with about this ``deadband``: about 13 s of ramps, steps, mixtures."""
    ramp, step, small = 2.0 * deadband + 0.03, deadband + 0.06, deadband + 0.02
    pieces = [Piece("rest", (), 0.0, 0.5)]
    pieces += [Piece("ramp", (j,), ramp, 2.0) for j in joints]
    pieces += [Piece("step", (j,), step, 1.2) for j in joints]
    pieces += [Piece("mixture", joints, small, 2.5, seed), Piece("rest", (), 0.0, 0.5)]
    return pieces


def held_out(deadband: float, joints: tuple[int, ...] = (0, 1, 2), seed: int = 2) -> list[Piece]:
    """Ten seconds that look otherwise than the usual excitation, to judge a fitted plant by."""
    return [
        Piece("mixture", joints, deadband + 0.06, 5.0, seed),
        Piece("mixture", joints, deadband + 0.04, 5.0, seed + 1),
    ]


def widest_overlap(config: PlantConfig) -> float:
    """The widest dead zone of the valves of slew, lift and tilt, half of the hysteresis included."""
    valves = [config.valves.of(name, 1.0) for name in JOINT_NAMES[:3]]
    return max(max(valve.deadband) + 0.5 * valve.hysteresis for valve in valves)


PERIOD_S = 0.01
FINE_STEP_MS = 0.2  # [D] other than the fit's, so that no error of integration is shared
PRESSURE_NOISE_BAR = 0.1  # [E] rms of a 250 bar transducer with 12 usable bits behind its filter


def record(
    config: PlantConfig, machine: Machine, pieces: list[Piece], held_out: list[Piece], seed: int
) -> MotionRecording:
    """What sensors tell while the plant ``config`` is driven through ``pieces``, then ``held_out``.

    The first of ``pieces`` is a rest. Encoders are as configured, pressures have white noise of
    ``PRESSURE_NOISE_BAR``; ``seed`` draws all of it.
    """
    valves = words([*pieces, *held_out], PERIOD_S)
    plant, noise = Plant(config, seed), np.random.default_rng([seed, 1])
    rows = []
    for k, row in enumerate(valves):
        image = plant.read()
        rows.append(
            [
                *image.encoder_counts,
                *np.ravel(image.pressures_bar),
                image.supply_bar,
                image.oil_temperature_degc,
            ]
        )
        a, b, c, d, e, f = row
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, (a, b, c, d, e, f)))
        plant.advance(round(PERIOD_S * 1e9))
    told: Array = np.array(rows, dtype=np.float64)
    told[:, 6:19] += PRESSURE_NOISE_BAR * noise.standard_normal((len(told), 13))
    about = About(
        arm=machine.arm,
        arm_hash=machine.arm_hash,
        valve_set=machine.valve_set,
        plant_hash=hex_hash(configuration_hash(config)),
        rest_s=pieces[0].seconds,
        held_out_from_s=round(seconds(pieces), 6),
        note=f"emulated, seed {seed}",
    )
    return MotionRecording(
        about,
        np.arange(len(told), dtype=np.float64) * PERIOD_S,
        valves,
        told[:, :6] / COUNTS_PER_RADIAN,
        told[:, 6:18].reshape(-1, N_ACTUATORS, 2) * BAR,
        told[:, 18] * BAR,
        told[:, 19],
    )
