"""How a stream ends: at its newest reference, at once without one, by a stop, with its session."""

import pytest

from controller.core.settings import ScanSettings
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.reference_messages import FLAG_SETTLED, FLAG_STREAMING
from tests.controller.obedient_plant import Bench
from tests.controller.streamed import ZERO, moved, opened, streamed


def test_the_end_of_a_stream_leads_to_its_newest_reference(settings: ScanSettings) -> None:
    bench = Bench(settings).streaming()
    goal = bench.shifted(z=0.1)
    stream_id = bench.last.view.motion_id
    assert bench.stream(bench.last.view.stream_number + 1, goal) is None
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    assert not bench.last.view.flags & FLAG_STREAMING
    refusal = bench.stream(3000, bench.shifted())
    assert refusal is not None
    assert refusal.reason is Reason.NOT_STREAMING
    bench.run(6.0)
    view = bench.last.view
    assert (view.motion_id, view.motion_done) == (stream_id, True)
    assert view.flags & FLAG_SETTLED
    assert view.X_BT_cmd.p_m == pytest.approx(goal.p_m, abs=1e-9)
    assert view.group_state is GroupState.STANDBY


def test_a_stream_without_references_ends_at_once(settings: ScanSettings) -> None:
    bench = opened(settings)
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    assert bench.last.view.group_state is GroupState.STANDBY
    assert bench.last.view.motion_done


def test_the_end_of_a_moving_reference_comes_to_rest(settings: ScanSettings) -> None:
    bench = opened(settings)
    home = bench.shifted()
    streamed(bench, 30.0, 1.5, lambda t: moved(home, 0.08 * t), (0.0, 0.08, 0.0, 0.0, 0.0, 0.0))
    last = bench.state.stream.goal.p  # type: ignore[union-attr]
    assert bench.command(CommandCode.END_STREAM) is Reason.ACCEPTED
    bench.run(4.0)
    assert bench.last.view.motion_done
    assert bench.last.view.X_BT_cmd.p_m == pytest.approx(last.tolist(), abs=1e-9)


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
