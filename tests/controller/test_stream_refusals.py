"""References that are refused: each by its cause, with nothing changed, and the stream no younger."""

import pytest

from controller.core.settings import ScanSettings
from protocol.faults import FaultCode, GroupState, Reason
from protocol.pose import Pose
from tests.controller.streamed import (
    opened,
)


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
