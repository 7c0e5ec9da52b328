"""Friction and load of one joint from its chamber pressures while it moves slowly; pure functions.

At speed v the load pressure p_a − (A_b/A_a) p_b carries the load, the friction against the motion and the
acceleration: p = g + g' (q − q̄) + sign(v) (f + f' (|v| − v̄)) + m dv/dt. Out and back pass the same angles,
so load and friction come apart. How friction splits into a constant and a viscous part these speeds do not
tell: it is told at their mean v̄. All in bar at chamber a: times its area it is the actuator's force.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from controller.core.excitation.plan import StrokeKind
from protocol.errors import MeasurementFailed
from testbed.commissioning.ramp_rows import smoothed_speed
from testbed.commissioning.recording import Array, StrokeRecord
from testbed.commissioning.uncertain import Uncertain, repeated

_MOVES = 0.3  # of the greatest speed of a stroke, above which it surely slides
_FLOOR_BAR = 0.15  # what the seals' own dynamics leave, as repeating shows on the emulator


class FrictionFindings(NamedTuple):
    """In bar at chamber a. ``load``: what the arm's weight puts on the actuator, in the middle of the travel;
    ``friction`` at ``speed`` (rad/s), the mean of the triangles."""

    load: Uncertain
    friction: Uncertain
    speed: float


def friction_findings(strokes: Sequence[StrokeRecord]) -> FrictionFindings:
    """Friction and load from the full triangles. Raises MeasurementFailed for fewer than two pairs."""
    triangles = [stroke for stroke in strokes if stroke.kind is StrokeKind.RAMP][2:]
    pairs = [(a, b) for a, b in pairwise(triangles) if a.sense != b.sense]
    if len(pairs) < 2:
        raise MeasurementFailed(
            "measurement.too_few_strokes", f"{len(pairs)} triangles out and back: two are wanted"
        )
    fits = np.array([_fit(a, b) for a, b in pairs])
    return FrictionFindings(
        load=repeated(fits[:, 0].tolist(), _FLOOR_BAR),
        friction=repeated(fits[:, 1].tolist(), _FLOOR_BAR),
        speed=float(fits[:, 2].mean()),
    )


def _fit(out: StrokeRecord, back: StrokeRecord) -> Array:
    """Load, friction and mean speed of one triangle out and one back."""
    middle = float(np.mean(np.concatenate([out.q, back.q])))
    speeds = [smoothed_speed(stroke) for stroke in (out, back)]
    mean = float(np.mean(np.concatenate([v[v > _MOVES * v.max()] for v in speeds])))
    blocks, targets = [], []
    for stroke, speed in zip((out, back), speeds, strict=True):
        rows = np.flatnonzero(speed > _MOVES * speed.max())
        sense, v = stroke.sense, stroke.sense * speed
        acceleration = np.gradient(v, stroke.t)
        columns = (
            np.ones_like(v), sense * np.ones_like(v), sense * (speed - mean), acceleration, stroke.q - middle
        )  # fmt: skip
        blocks.append(np.column_stack(columns)[rows])
        targets.append(sense * stroke.load[rows])
    matrix, wanted = np.vstack(blocks), np.concatenate(targets)
    units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    solved, *_ = np.linalg.lstsq(matrix / units, wanted, rcond=None)
    return np.array([*(solved / units)[:2], mean])
