"""One joint behind a poor valve, at rest: overlap, delay, lag, creep, oil that is compressed."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from controller.core.parking.joint import SHUT, ParkingLaw, joints_in_motion
from controller.core.parking.parking import joint_spool
from protocol.process_image import VALVE_FULL_SCALE

DT_S, GAIN, DIGIT, BAND_RAD = 0.005, 0.4, 4.8e-5, 1e-4
GAINS = np.full(2, GAIN)
DELAY_S, LAG_S = 0.012, 0.057
ONES = np.ones(6)
OIL_RAD_BAR, RELAXES_S = 3.5e-4, 2.0


def poor_law(deadband: float = 0.08, doubt: float = 0.008) -> ParkingLaw:
    late = DELAY_S + LAG_S + 1.5 * DT_S
    return ParkingLaw(
        band=4e-4,
        band_most=2e-4,
        slowest=4e-4,
        patience=6.0,
        tolerance=2.7e-4,
        stays=30.0,
        early=np.full((6, 2), deadband - doubt),
        doubt=np.full((6, 2), doubt),
        surely_open=np.full((6, 2), 2.0 * deadband),
        latest=(late + 0.3) * ONES,
        shutting=(late + 0.13) * ONES,
        loaded=ONES,
        oil_spring=OIL_RAD_BAR * ONES,
        dt_s=DT_S,
    )


class Joint(NamedTuple):
    """A joint ``error`` (rad) off whose valve opens at ``edge``; it creeps by itself (rad/s).

    ``half_play``: before its encoder (rad). Its oil is compressed by ``squeezed`` rad of its way, of which
    friction holds ``sticks`` for good; what is beyond that lets go of within seconds. ``oil``: how far the
    joint moves a bar (rad).
    """

    error: float = 0.0
    edge: float = 0.08
    creep: float = 0.0
    half_play: float = 0.0
    squeezed: float = 0.0
    sticks: float = 0.0
    oil: float = OIL_RAD_BAR


class Rest(NamedTuple):
    """True errors (rad) and spool commands of every scan, whether the joint might stay, the last record."""

    errors: np.ndarray
    spools: np.ndarray
    rests: np.ndarray
    record: np.ndarray

    @property
    def openings(self) -> int:
        """How often the valve was opened."""
        return int((np.diff(np.r_[0.0, np.abs(self.spools) > 0.0]) > 0.0).sum())


def resting(law: ParkingLaw, joint: Joint, seconds: float, settled: bool = False) -> Rest:
    """What parking makes of the joint; it follows its oil late, and the engine shakes its load pressure."""
    rng, record, speed = np.random.default_rng(5), joints_in_motion(), 0.0
    record["phase"], record["error"] = SHUT, joint.error
    for name in ("slow", "place", "mark"):
        record[name] = joint.error
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    angle, oil, spool, seen, rows = -joint.error, -joint.error + joint.squeezed, 0.0, -joint.error, []
    shaft = angle + math.copysign(joint.half_play, joint.creep)
    for scan in range(round(seconds / DT_S)):
        shaft = min(max(shaft, angle - joint.half_play), angle + joint.half_play)
        before, seen = seen, DIGIT * round((shaft + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        speed = keep * speed + (1.0 - keep) * (seen - before) / DT_S
        record["since"][0] += DT_S
        record["away"][0] += DT_S
        load = (oil - angle) / joint.oil + 0.2 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan)
        command, rests = joint_spool(law, record[0], 0, (-seen, load, speed), BAND_RAD, settled, GAINS)
        late = commands[0]
        commands.append(round(command * VALVE_FULL_SCALE) / VALVE_FULL_SCALE)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        oil += DT_S * (GAIN * math.copysign(max(abs(spool) - joint.edge, 0.0), spool) + joint.creep)
        pulls = max(abs(oil - angle) - joint.sticks, 0.0)
        angle += DT_S * math.copysign(pulls, oil - angle) / RELAXES_S
        rows.append((-angle, command, rests))
    errors, spools, stays = np.array(rows).T
    return Rest(errors, spools, stays, record)
