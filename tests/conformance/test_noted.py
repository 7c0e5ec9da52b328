"""What is noted of all that a controller sends, where the machine under it was busy."""

import pytest

from conformance.noted import Always, Noted
from protocol.datagram import Header, decode, encode
from protocol.faults import FaultCode, GroupState, Severity
from protocol.pose import IDENTITY
from protocol.reference_messages import State, Welcome

CYCLE_NS = 5_000_000
ZEROS = (0.0,) * 6


def state(cycle: int, time_ns: int, overruns: int) -> State:
    """A STATE of an arm at rest."""
    return State(
        time_ns=time_ns, cycle=cycle, group_state=GroupState.STANDBY, fault=FaultCode.NONE,
        severity=Severity.NONE, flags=1, motion_id=0, motion_done=False, segment=0, q_meas=ZEROS, q_cmd=ZEROS,
        valves=ZEROS, X_BT=IDENTITY, X_BT_cmd=IDENTITY, supply_bar=190.0, overruns=overruns,
        lateness_p50_us=0, lateness_p99_us=0, lateness_max_us=0, references_lost=0, references_dropped=0,
        plant_exchange_failures=0, stream_number=0,
    )  # fmt: skip


@pytest.mark.parametrize(("counted", "breaks"), [(0, True), (19, False)])
def test_scans_that_a_busy_machine_left_out_are_believed_if_they_are_counted(
    counted: int, breaks: bool
) -> None:
    noted = Noted()
    welcome = Welcome(1, 0, 1, 1, CYCLE_NS, 500, 0)
    sent = [welcome, state(1, CYCLE_NS, 0), state(2, 2 * CYCLE_NS + 19 * CYCLE_NS, counted)]
    for number, message in enumerate(sent):
        data = encode(message, Header(7, number, number))
        noted.look(data, decode(data), whole=True)
    assert (Always.MISCOUNTED in noted.breaches) is breaks
