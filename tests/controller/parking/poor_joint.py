"""One joint behind a poor valve, at rest: overlap known within a fifth, hysteresis, delay, lag, creep."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from controller.core.parking.joint import SHUT, ParkingLaw, joints_at_start
from controller.core.parking.parking import phase_spool
from controller.core.parking.rest import watch_creep
from protocol.process_image import VALVE_FULL_SCALE

DT_S, GAIN, DIGIT, BAND_RAD = 0.005, 0.4, 4.8e-5, 1e-4
GAINS = np.full(2, GAIN)
DELAY_S, LAG_S = 0.012, 0.057
ONES = np.ones(6)
BAR_RAD = 5e3  # friction before it slides is a spring: 0.2 bar for 40 µrad


def poor_law(deadband: float, spread: float) -> ParkingLaw:
    late = DELAY_S + LAG_S + 1.5 * DT_S
    return ParkingLaw(
        band=4e-4,
        band_least=7e-5,
        band_most=2e-4,
        slowest=4e-4,
        fastest=1e-2,
        patience=6.0,
        calm_travel=2e-4,
        calm=3.0,
        settled=2.7e-4,
        give_up=30.0,
        quiet=1e-4,
        deadband=np.full((6, 2), deadband),
        spread=np.full((6, 2), spread),
        latest=(late + 0.15) * ONES,
        shutting=(late + 0.03) * ONES,
        loaded=ONES,
        oil_spring=0.0 * ONES,
        surely_open=np.full((6, 2), 2.0 * deadband),
        dt_s=DT_S,
    )


class Rest(NamedTuple):
    """Errors (rad), true and by the encoder, spool commands and phases of every scan."""

    errors: np.ndarray
    seen: np.ndarray
    spools: np.ndarray
    phases: np.ndarray
    state: np.ndarray


class Joint(NamedTuple):
    """A joint ``error`` off whose valve opens at ``edge``; it creeps by itself (rad/s).

    ``half_play``: before its encoder (rad); ``ramp``: of the creep (rad/s²).
    """

    error: float
    edge: float
    creep: float
    half_play: float = 0.0
    ramp: float = 0.0


def resting(law: ParkingLaw, joint: Joint, seconds: float, parked: bool = True, phase: float = SHUT) -> Rest:
    rng, state = np.random.default_rng(5), joints_at_start(law)
    state["phase"][0], state["band"][0], state["rest"][0] = phase, BAND_RAD, float(parked)
    state["jog"]["sense"][0] = -math.copysign(1.0, joint.creep)
    state["error"][0] = state["watch"]["error"][0] = joint.error
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    angle, seen, spool = -joint.error, -joint.error, 0.0
    shaft = angle + math.copysign(joint.half_play, joint.creep)
    rows = []
    for scan in range(round(seconds / DT_S)):
        shaft = min(max(shaft, angle - joint.half_play), angle + joint.half_play)
        before, seen = seen, DIGIT * round((shaft + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state["speed"][0] = keep * state["speed"][0] + (1.0 - keep) * (seen - before) / DT_S
        state["since"][0] += DT_S
        state["pulse"]["since"][0] += DT_S
        watch_creep(law, state[0], 0, 4.0, -seen, 50.0)
        command = phase_spool(law, state, 0, -seen, 50.0 + BAR_RAD * angle, GAINS)
        late = commands[0]
        commands.append(round(command * VALVE_FULL_SCALE) / VALVE_FULL_SCALE)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        beyond = max(abs(spool) - joint.edge, 0.0)
        angle += DT_S * (math.copysign(GAIN * beyond, spool) + joint.creep + joint.ramp * DT_S * scan)
        rows.append((-angle, -shaft, command, state["phase"][0]))
    return Rest(*np.array(rows).T, state)
