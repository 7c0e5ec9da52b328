"""Every limit of a stroke, each broken alone: its cause, the joint, the value and the limit."""

from typing import NamedTuple

import numpy as np
import pytest

from controller.core.excitation.plan import (
    PATIENCE_S,
    Excitation,
    ExcitationPlan,
    Measured,
    Phase,
    StrokeKind,
    begun,
)
from controller.core.excitation.strokes import broken_off, excite
from tests.controller.excitation.toy_valve import DT_S, START, plan_for

JOINT = 5


class Instant(NamedTuple):
    """A stroke as it stands: ``turned`` (rad) along its sense, ``speed`` (rad/s) of the joint."""

    turned: float = 0.02
    speed: float = 0.02
    spool: float = 0.05
    stroke_s: float = 2.0
    still_s: float = 0.0
    swing: float = 1.0
    reversals: int = 0
    phase: Phase = Phase.RISING
    start: float = 0.0
    pressure_bar: float = 100.0
    other: float = 0.0
    creep: float = 0.0
    sense: float = 1.0


def judged(plan: ExcitationPlan, now: Instant) -> object:
    """The cause with which this instant is broken off, None while it is inside all limits."""
    q_start = START.copy()
    q_start[JOINT] = now.start
    q = q_start.copy()
    q[JOINT] += now.sense * now.turned
    q[4] += now.other
    speed, creep = np.zeros(6), np.zeros(6)
    speed[JOINT], creep[4] = now.sense * now.speed, now.creep
    state: Excitation = begun(q_start)._replace(
        phase=now.phase, stroke_s=now.stroke_s, still_s=now.still_s, spool=now.spool, speed=speed,
        swing=now.swing, reversals=now.reversals, creep=creep, away=now.sense,
    )  # fmt: skip
    stroke = next(each for each in plan.strokes if each.kind is StrokeKind.RAMP)
    failure = broken_off(plan.limits, stroke, state, Measured(q, now.pressure_bar))
    if failure is None:
        return None
    assert failure.joint == JOINT
    return failure.cause.removeprefix("commissioning.")


@pytest.mark.parametrize(
    ("now", "cause"),
    [
        (Instant(), None),
        (Instant(turned=-0.01, speed=-0.02), "wrong_way"),
        (Instant(turned=-0.01, speed=-0.001), None),  # it creeps, its valve closed
        (Instant(spool=0.31), "no_motion"),
        (Instant(stroke_s=41.0), "too_slow"),
        (Instant(still_s=1.1, speed=0.0), "blocked"),
        (Instant(still_s=1.1, speed=0.0, swing=0.0), None),  # it never moved under this valve
        (Instant(still_s=1.1, speed=0.0, phase=Phase.FALLING), None),
        (Instant(reversals=4), "oscillates"),
        (Instant(turned=0.15), "too_far"),
        (Instant(speed=0.8), "too_fast"),
        (Instant(start=np.radians(89.0), turned=0.02), "joint_limit"),
        (Instant(start=np.radians(-89.0), sense=-1.0), "joint_limit"),
        (Instant(pressure_bar=270.0), "pressure"),
        (Instant(other=0.04), "other_joint_moved"),
        (Instant(other=0.04, creep=0.015), None),  # it crept as fast before the stroke
    ],
)
def test_each_limit_is_named(now: Instant, cause: str | None) -> None:
    assert judged(plan_for(JOINT), now) == cause


def test_an_arm_that_never_comes_to_rest_is_named() -> None:
    plan = plan_for(JOINT)
    q, state, failure = START.copy(), begun(START), None
    for _ in range(round((PATIENCE_S + 1.0) / DT_S)):
        q[JOINT] += DT_S * 5e-3
        state, failure = excite(plan, state, Measured(q.copy(), 100.0), DT_S)
        if failure is not None:
            break
    assert failure is not None
    assert (failure.cause, state.spool) == ("commissioning.not_at_rest", 0.0)
