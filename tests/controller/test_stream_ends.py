"""How a stream ends: at its newest reference, at once without one, by a stop, with its session."""

from controller.core.settings import ScanSettings
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from tests.controller.obedient_plant import Bench
from tests.controller.streamed import ZERO


def test_a_stop_ends_a_stream(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number, goal = bench.last.view.stream_number + 1, bench.shifted(z=0.2)
    assert bench.command(CommandCode.STOP) is Reason.ACCEPTED
    refusal = bench.stream(number, goal)
    assert refusal is not None
    assert refusal.reason is Reason.STOPPING
    bench.run(2.0)
    assert bench.last.view.group_state is GroupState.STANDBY
    assert not bench.last.view.motion_done
    refusal = bench.stream(number + 1, goal)
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING


def test_the_end_of_the_session_closes_its_stream_to_the_next_one(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    number, goal = bench.last.view.stream_number + 1, bench.shifted(z=0.2)
    bench.link_alive = False
    bench.step()
    bench.link_alive = True
    refusal = bench.stream(number, goal)
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING
    assert bench.command(CommandCode.END_STREAM) is Reason.NOT_STREAMING
    bench.run(0.1)
    assert bench.last.view.fault is FaultCode.REFERENCE_STALE
    assert bench.last.valves.valves == ZERO
