"""Deadband, hysteresis and lag of one valve edge from where its flow begins and ends; pure functions."""

from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_fit import RampFits
from testbed.commissioning.uncertain import Uncertain

# Neighbouring rows err alike: a digit of an encoder stands for several scans of a slow ramp, and a model that
# is off by a few µrad is so for long. Times a rim's spread by white noise; [M] lifts and slews of 9201 to
# 9221: blocks of a quarter second scatter 1 to 2.3 times as much.
_ALIKE = 2.0
_RIM_STD = 3.0e-6  # of one rim, beyond what its rows' noise leaves
_PACES = 0.2  # of the mean rate: rates that differ by less are one


class Floor(NamedTuple):
    """Standard deviations (of spool) that all rims share, whatever their number."""

    deadband: float
    hysteresis: float


class Loop(NamedTuple):
    """``deadband``, ``hysteresis``: of the spool; ``lag`` (s): from a slowly changing command to the flow."""

    deadband: Uncertain
    hysteresis: Uncertain
    lag: Uncertain


def loop_of(ramps: RampFits, floor: Floor) -> Loop:
    """The Loop whose rims c = d ± (h/2 + ρ τ), + where flow begins, come closest to those of ``ramps``.

    Each rim counts as much as its rows tell of it, and all are told with the scatter that they have, where it
    is more than that. Raises MeasurementFailed (``measurement.one_pace``) where all rates ρ are alike.
    """
    if np.ptp(ramps.rates) < _PACES * ramps.rates.mean():
        raise MeasurementFailed(
            "measurement.one_pace", "all ramps have one pace: hysteresis and lag look alike"
        )
    matrix = np.column_stack([np.ones_like(ramps.rims), 0.5 * ramps.ways, ramps.ways * ramps.rates])
    covariance = _ALIKE**2 * ramps.covariance + _RIM_STD**2 * np.eye(len(ramps.rims))
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    found, *_ = np.linalg.lstsq(white @ matrix, white @ ramps.rims, rcond=None)
    left = white @ (ramps.rims - matrix @ found)
    free = len(left) - len(found)
    wider = max(float(left @ left) / free, 1.0) if free else 1.0
    spread = wider * np.linalg.inv(matrix.T @ np.linalg.inv(covariance) @ matrix)
    shared = (floor.deadband, floor.hysteresis, 0.0)
    stds = np.sqrt(np.diag(spread) + np.square(shared))
    return Loop(*(Uncertain(float(v), float(s)) for v, s in zip(found, stds, strict=True)))
