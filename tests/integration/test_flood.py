"""Fault 19: a flood of 50 000 datagrams a second on the port of a real controller that moves an arm.

Whether the scan stays in time is a bench, for this machine may be busy: ``make bench``.
"""

import time
from pathlib import Path

import pytest

from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.process_image import STATUS_VALVES_ENABLED
from protocol.reference_messages import State
from tests.integration.flood import flooding
from tests.support.killed_controller import KillRig, insist, trial_rig
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.realtime

RATE_HZ = 50_000.0


def moved(rig: KillRig, offset_m: tuple[float, float, float]) -> State:
    """The state in the middle of a motion."""
    assert rig.client.move_by(offset_m).reason is Reason.ACCEPTED
    return rig.client.until(lambda s: max(map(abs, s.valves)) > 0.01, 3.0)


@pytest.mark.slow("services start")
@pytest.mark.timeout(300)
def test_case_19_a_flood_leaves_the_motion_alone_and_stop_works(tmp_path: Path) -> None:
    with trial_rig(CONFIGS, [], tmp_path) as (launch, rig):
        client, port = rig.client, launch.settings.controller.reference_link.port
        client.connect()
        insist(client, CommandCode.ENABLE)
        client.until(lambda s: s.group_state is GroupState.STANDBY, 5.0)
        with flooding(port, RATE_HZ, 4.0):
            client.pump(0.7)  # the flood's process starts
            moved(rig, (0.0, 0.4, 0.0))
            client.pump(0.8)
            assert client.state is not None
            assert (client.state.group_state, client.state.fault) == (GroupState.MOVING, FaultCode.NONE)
            asked_s = time.monotonic()
            assert client.command(CommandCode.STOP) is Reason.ACCEPTED
            client.until(lambda s: s.group_state is GroupState.STANDBY, 3.0)
            stopped_s = time.monotonic() - asked_s
            assert client.command(CommandCode.DISABLE) is Reason.ACCEPTED
            client.until(lambda s: s.group_state is GroupState.DISABLED, 3.0)
            client.pump(0.3)
            assert not rig.status() & STATUS_VALVES_ENABLED
            assert client.state.references_dropped > 1000
    assert stopped_s < 2.0
