"""References that are refused: each by its cause, with nothing changed, and the stream no younger."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from controller.core.settings import ScanSettings
from protocol.faults import FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import StreamRefused
from tests.controller.obedient_plant import Bench
from tests.controller.streamed import (
    moved,
    opened,
    turned,
)


def edge(settings: ScanSettings) -> float:
    return settings.streaming.distance_m


REFUSED = [
    (lambda p, s: p._replace(p_m=(math.nan, 0.0, 0.0)), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p._replace(p_m=(p.p_m[0], 1e-310, p.p_m[2])), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p._replace(q_wxyz=(math.inf, 0.0, 0.0, 0.0)), {}, Reason.NOT_FINITE, None),
    (lambda p, s: p, {"twist_ref": (0.0, math.nan, 0.0, 0.0, 0.0, 0.0)}, Reason.NOT_FINITE, None),
    (lambda p, s: p, {"twist_ref": (0.0, 0.0, 0.0, 1e-310, 0.0, 0.0)}, Reason.NOT_FINITE, None),
    (
        lambda p, s: p._replace(q_wxyz=tuple(1.002 * q for q in p.q_wxyz)),
        {},
        Reason.NOT_UNIT_QUATERNION,
        1.002,
    ),
    (lambda p, s: moved(p, 1.001 * edge(s)), {}, Reason.TOO_FAR, 0.5005),
    (lambda p, s: turned(p, np.array([0.0, 0.0, 0.54])), {}, Reason.TOO_FAR, 0.54),
    (lambda p, s: p, {"age_s": 0.26}, Reason.STALE, 0.26),
    (lambda p, s: p, {"twist_ref": (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)}, Reason.TOO_FAST, 0.2),
    (lambda p, s: p, {"twist_ref": (0.0, 0.0, 0.0, 0.0, 0.0, -0.2)}, Reason.TOO_FAST, 0.2),
    (lambda p, s: p, {"stream_id": 9_999}, Reason.NOT_STREAMING, 9999.0),
]


@pytest.mark.parametrize(("spoil", "more", "reason", "value"), REFUSED)
def test_what_is_refused_changes_nothing(
    settings: ScanSettings,
    spoil: Callable[[Pose, ScanSettings], Pose],
    more: dict[str, object],
    reason: Reason,
    value: float | None,
) -> None:
    bench = opened(settings)
    assert bench.stream(1, bench.shifted(y=0.02)) is None
    stream, path = bench.state.stream, bench.state.motion.path
    at = Pose(*bench.last.view.X_BT_cmd)
    refusal = bench.stream(2, spoil(at, settings), **more)
    assert isinstance(refusal, StreamRefused)
    assert refusal.reason is reason
    if value is not None:
        assert refusal.value == pytest.approx(value, abs=2e-3)
    assert bench.state.stream is stream
    assert bench.state.motion.path is path
    assert ("streamed", reason.name) in [event[:2] for event in bench.last.events]


@pytest.mark.parametrize(
    ("way", "reason"),
    [((1.0, 0.0, 0.0), Reason.OUTSIDE_WORKSPACE), ((0.0, 0.0, -1.0), Reason.OUTSIDE_WORKSPACE)],
)
def test_references_that_lead_out_are_refused_on_the_way(
    settings: ScanSettings, way: tuple[float, float, float], reason: Reason
) -> None:
    bench = opened(settings)
    for number in range(1, 4000):
        x, y, z = bench.last.view.X_BT_cmd.p_m
        ahead = Pose((x + 0.1 * way[0], y + 0.1 * way[1], z + 0.1 * way[2]), bench.last.view.X_BT_cmd.q_wxyz)
        refusal = bench.stream(number, ahead)
        if refusal is not None:
            break
    assert refusal is not None
    assert refusal.reason in (reason, Reason.UNREACHABLE, Reason.JOINT_LIMIT, Reason.SINGULAR)
    assert bench.last.view.group_state is GroupState.MOVING
    bench.run(0.2)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE  # and not a limit that was run into


def test_a_reference_outside_any_stream_is_told_the_id_it_named(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    refusal = bench.stream(1, bench.shifted(), stream_id=4711)
    assert refusal is not None
    assert (refusal.reason, refusal.value, refusal.limit) == (Reason.NOT_STREAMING, 4711.0, 0.0)
