"""EMERGENCY_STOP behind a flood of its own client, at a real controller that moves an arm.

`make experiments` tries it a hundred times and prints how long it takes; see clauses 6.12 to 6.14.
"""

import math
import time
from pathlib import Path

import numpy as np
import pytest

from conformance.peer import Peer
from conformance.reference.motion import moved
from conformance.wire import NonceSource, Unsupported
from protocol.faults import CommandCode, GroupState, Reason
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, Command, ReferencePose, State
from testbed.experiments.robustness.controller_kills import trial_rig
from tests.support.paths import CONFIGS

FLOOD = 50_000
LAST = 2_000  # of them, after the answers to the others were read: what comes then is read at once
REPEAT_MS = 20.0
SCANS = 3


def ready(peer: Peer) -> State:
    """The state in STANDBY, from wherever the trial before has left the group."""
    until_s = time.monotonic() + 10.0
    while time.monotonic() < until_s:
        state = peer.state()
        if state.group_state is GroupState.STANDBY:
            return state
        for code in (CommandCode.EMERGENCY_RELEASE, CommandCode.RESET, CommandCode.ENABLE):
            peer.command(code)
        peer.collect(50.0)
    raise Unsupported(f"the group stays in {state.group_state.name}")


def flood(peer: Peer, count: int) -> None:
    for _ in range(count):
        peer.send(Command(peer.new_id(), CommandCode.ENABLE))


def trial(peer: Peer, dy_m: float, *, stopping: bool) -> float:
    """ms from sending EMERGENCY_STOP to the scan whose valve words are zero, by the machine's one clock."""
    here = ready(peer).X_BT_cmd
    answer = peer.ask(ReferencePose(peer.new_id(), moved(here, dy=dy_m), 12.0), "a motion")
    assert answer.reason is Reason.ACCEPTED, answer
    flood(peer, FLOOD - LAST)
    peer.collect(50.0)
    peer.transcript.clear()
    flood(peer, LAST)
    if stopping:
        peer.send(Command(peer.new_id(), CommandCode.STOP))
    emergency = Command(peer.new_id(), CommandCode.EMERGENCY_STOP)
    sent_ns = time.monotonic_ns()
    while time.monotonic_ns() - sent_ns < 5_000_000_000:
        peer.send(emergency)
        for datagram in peer.collect(REPEAT_MS):
            state = datagram.message
            if isinstance(state, State) and state.flags & FLAG_EMERGENCY_LATCHED:
                assert state.valves == (0.0,) * 6
                return (state.time_ns - sent_ns) / 1e6
    raise AssertionError("the emergency stop was not obeyed within 5 s")


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "trials", [pytest.param(3, marks=pytest.mark.realtime), pytest.param(100, marks=pytest.mark.experiment)]
)
def test_an_emergency_stop_does_not_wait_behind_50_000_requests(
    trials: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with trial_rig(CONFIGS, [], tmp_path) as (launch, _):
        link = launch.settings.controller.reference_link
        peer = Peer(link.host, link.port, NonceSource(time.time_ns()))
        cycle_ms = peer.open(period_ms=0).cycle_ns / 1e6
        taken_ms = [trial(peer, 0.2 * (-1) ** number, stopping=number % 2 == 1) for number in range(trials)]
        peer.leave()
        peer.close()
    half, most, top = np.percentile(taken_ms, [50, 99, 100])
    with capsys.disabled():
        print(
            f"\nEMERGENCY_STOP behind {FLOOD} requests, {trials} trials, ms to the scan with zero valves: "
            f"p50 {half:.1f}, p99 {most:.1f}, max {top:.1f}; a scan is {cycle_ms:g} ms"
        )
    # The next exchange carries these words to the plant.
    assert math.ceil(half / cycle_ms) + 1 <= SCANS
    assert math.ceil(most / cycle_ms) + 1 <= SCANS or trials < 100
