"""Rows of a ramp: its halves and plateaus."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from testbed.commissioning.recording import Array, StrokeRecord

SLOW, _FAST = 0.15, 0.92  # of the ramp's top speed, between which its halves are used
_SMOOTH_S = 0.2  # of the speed that sorts samples; the fit itself uses angles
FED_BAR = 1.0  # above the tank: less, and a chamber is filled from there, and its edge meters nothing
SHORTEST_S = 0.2  # in motion, of a run of rows
_LEAST_HALVES = 2  # of a way
_CROSSED_RAD = 2.0e-3  # of a triangle, after which oil no longer moves an actuator within its play
_FOLLOWS_S = 0.35  # a spool, until it lags behind a ramp by as much as it will: 4 Hz, well damped
_GAP_SAMPLES = 4


class Half(NamedTuple):
    """Runs of rows on one half of a triangle, in all ``seconds``; ``way``: 1 rising, −1 falling."""

    stroke: StrokeRecord
    runs: list[NDArray[np.intp]]
    way: float
    seconds: float


def rate_of(stroke: StrokeRecord) -> float:
    """The rate (1/s) at which the command of a ramp goes."""
    return float(np.median(np.abs(np.diff(stroke.u)) / np.diff(stroke.t)))


def halves_of(triangles: Sequence[StrokeRecord], compliance: float) -> list[Half]:
    """Of every triangle the halves with enough rows in motion, or with flow, while their edge meters.

    Raises MeasurementFailed where fewer than two rise, or fall.
    """
    found: list[Half] = []
    for name, way in (("rising", 1.0), ("falling", -1.0)):
        halves = sorted((_half(stroke, way, compliance) for stroke in triangles), key=lambda h: -h.seconds)
        second = halves[_LEAST_HALVES - 1].seconds if len(halves) >= _LEAST_HALVES else 0.0
        if second < SHORTEST_S:
            raise MeasurementFailed(
                "measurement.ramp_too_short",
                f"{second:.2f} s in motion on the {name} ramp, at least {SHORTEST_S:g} s wanted on "
                f"{_LEAST_HALVES} of them",
            )
        found += [half for half in halves if half.seconds >= SHORTEST_S]
    return found


def _half(stroke: StrokeRecord, way: float, compliance: float) -> Half:
    flow = smoothed_speed(stroke, compliance)
    index, top = np.arange(len(flow)), float(flow.max())
    mine = (index < stroke.top) if way > 0.0 else (index > stroke.top)
    flows = (flow > SLOW * top) & (flow < _FAST * top) & _moves(stroke)
    runs = runs_of(mine & flows & is_settled(stroke) & (stroke.fed_bar > FED_BAR))
    longest = max((_seconds(stroke, rows) for rows in runs), default=0.0)
    return Half(stroke, [rows for rows in runs if _seconds(stroke, rows) >= SHORTEST_S], way, longest)


def is_settled(stroke: StrokeRecord) -> NDArray[np.bool_]:
    """Whether the command has gone at the ramp's rate for as long as a spool takes to follow it (n,)."""
    quick = np.abs(np.gradient(stroke.u, stroke.t)) >= 1.5 * rate_of(stroke)  # a start, the turn at the top
    since = np.where(quick, stroke.t, stroke.t[0])
    return np.asarray(~quick & (stroke.t - np.maximum.accumulate(since) > _FOLLOWS_S))


def plateaus(stroke: StrokeRecord) -> list[NDArray[np.intp]]:
    """The runs of a step in motion, once its flow is steady and metered by the edge that is told."""
    moves = _moves(stroke)
    began_s = stroke.t[np.argmax(moves)]
    steady = (stroke.t > began_s + _FOLLOWS_S) & moves & (stroke.fed_bar > FED_BAR)
    return [rows for rows in runs_of(steady) if _seconds(stroke, rows) >= SHORTEST_S]


def _moves(stroke: StrokeRecord) -> NDArray[np.bool_]:
    """Where the joint moves, its play taken up (n,)."""
    speed = smoothed_speed(stroke)
    return np.asarray((speed > SLOW * float(speed.max())) & (stroke.turned > _CROSSED_RAD))


def _seconds(stroke: StrokeRecord, rows: NDArray[np.intp]) -> float:
    return float(stroke.t[rows[-1]] - stroke.t[rows[0]])


def runs_of(flags: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """The runs of samples for which ``flags`` hold; noise may interrupt one shortly."""
    rows = np.flatnonzero(flags)
    if len(rows) == 0:
        return []
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > _GAP_SAMPLES) + 1)
    return [np.arange(run[0], run[-1] + 1) for run in runs]


def smoothed_speed(stroke: StrokeRecord, compliance: float = 0.0) -> Array:
    """The mean speed (n,) rad/s along the stroke's sense over a window about each sample; with
    ``compliance`` (rad/bar) that of the oil that flows in."""
    passed = stroke.turned + compliance * stroke.inlet
    half = max(1, round(0.5 * _SMOOTH_S / float(np.median(np.diff(stroke.t)))))
    index = np.arange(len(stroke.t))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(index) - 1)
    return np.asarray((passed[after] - passed[before]) / (stroke.t[after] - stroke.t[before]))


class Uncertain(NamedTuple):
    """``value`` with its standard deviation ``std``, in the same unit."""

    value: float
    std: float


def midway(a: Uncertain, b: Uncertain) -> Uncertain:
    """The mean of two independent estimates."""
    return Uncertain(0.5 * (a.value + b.value), 0.5 * math.hypot(a.std, b.std))
