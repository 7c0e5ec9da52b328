"""Faults 5 to 11 and 18 of the reference link, judged at the plant's registers."""

import numpy as np
import pytest

from protocol.client_session import ReferenceClient
from protocol.datagram import decode, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.reference_messages import Command, ReferencePose
from testbed.lockstep.clock import run
from tests.faults.registers import assert_driving, assert_shut
from tests.faults.rig import CLOSING_NS, MS, FaultRig

pytestmark = pytest.mark.slow("whole worlds in lockstep")

SESSION_END_S = 0.5 + 0.7  # the link's timeout, then the ramp


def test_case_05_reordered_the_older_is_dropped_and_a_late_motion_does_not_overtake_the_stop() -> None:
    rig = FaultRig().moving()
    world = rig.world
    kept: list[bytes] = []

    def wire(datagrams: list[bytes]) -> list[bytes]:
        kept.extend(datagrams)
        return []

    world.to_controller = wire
    world.link.submit(ReferencePose(0, rig.shifted(z=0.3), 0.0))
    rig.run(0.01)
    stop = world.link.submit(Command(0, CommandCode.STOP))
    rig.run(0.01)
    motion, *_, last = [data for data in kept if len(data) > HEADER_BYTES + 8]
    before = world.controller._server.statistics
    world.to_controller = lambda _: [last, motion]
    world.clock.advance()
    world.to_controller = list
    after = world.controller._server.statistics
    assert after.reordered == before.reordered + 1
    assert run(world.link.answer(stop)).reason is Reason.ACCEPTED
    rig.run(2.5)
    assert rig.state.group_state is GroupState.STANDBY
    rested_ns = rig.now_ns
    rig.run(0.5)
    tool = [truth.X_WT[:3, 3] for truth in world.truths if truth.time_ns > rested_ns]
    assert np.linalg.norm(tool[-1] - tool[0]) < 2e-3


def test_case_06_one_datagram_a_hundred_times_has_one_effect() -> None:
    single, many = FaultRig().enabled(), FaultRig().enabled()
    many.world.to_controller = lambda datagrams: [data for data in datagrams for _ in range(100)]
    for rig in (single, many):
        assert rig.ask(ReferencePose(0, rig.shifted(y=0.1), 0.0)).reason is Reason.ACCEPTED
        rig.run(1.0)
    assert_driving(many.registers, 0)
    assert [row.image for row in single.registers.written] == [row.image for row in many.registers.written]
    assert many.world.controller._server.statistics.duplicated > 99 * 10


def test_case_07_the_sequence_wraps_within_a_motion() -> None:
    rig = FaultRig()
    rig.world.open_link(nonce=5, first_sequence=2**32 - 9)
    rig.until(lambda: rig.world.link.connected)
    rig.moving()
    rig.assert_completes()
    assert rig.world.link.session._channel.next_sequence < 2**31  # it has wrapped
    assert rig.world.controller._server.statistics.dropped == 0


def test_case_08_a_sequence_reset_within_a_session_is_refused() -> None:
    rig = FaultRig().moving()
    began_ns, server = rig.now_ns, rig.world.controller._server
    rig.world.link.session._channel.next_sequence = 1
    rig.run(2.0)
    assert server.statistics.dropped > 3
    rig.assert_safe(FaultCode.REFERENCE_LINK_LOST, began_ns, SESSION_END_S)


def test_case_09_vision_restarts_and_nothing_moves_until_it_is_armed_again() -> None:
    rig = FaultRig().moving()
    began_ns = rig.now_ns
    rig.reconnect()
    rig.run(1.5)
    rig.assert_safe(FaultCode.REFERENCE_LINK_LOST, began_ns, 0.8)
    assert rig.command(CommandCode.RESET) is Reason.ACCEPTED
    assert rig.ask(ReferencePose(0, rig.shifted(z=0.05), 0.0)).reason is Reason.DISABLED
    assert_shut(rig.registers, began_ns + 800 * MS + CLOSING_NS)
    rig.enabled()
    assert rig.ask(ReferencePose(0, rig.shifted(z=0.05), 0.0)).reason is Reason.ACCEPTED
    rearmed_ns = rig.now_ns
    rig.assert_completes()
    assert_driving(rig.registers, rearmed_ns)


def references_at_60_hz(rig: FaultRig, seconds: float) -> list[bytes]:
    """What a client sends that goes on for ``seconds`` from now, in order and without a gap."""
    channel, first_ns = rig.world.link.session._channel, rig.world.vision_ns
    datagrams = []
    for k in range(round(60 * seconds)):
        message = ReferencePose(2**60 + k, rig.shifted(z=0.3), 0.0)
        datagrams.append(channel.encoded(message, first_ns + k * 1_000_000_000 // 60))
    return datagrams


def test_case_10_a_backlog_of_2_s_is_dropped_whole() -> None:
    rig = FaultRig().moving()
    began_ns, server = rig.now_ns, rig.world.controller._server
    backlog = references_at_60_hz(rig, 2.0)
    rig.world.to_controller = lambda _: []
    rig.run(2.0)
    before = server.statistics
    rig.world.to_controller = lambda _: backlog
    rig.world.clock.advance()
    rig.world.to_controller = list
    assert server.statistics.received == before.received
    assert server.statistics.dropped - before.dropped == len(backlog) == 120
    rig.run(0.5)
    rig.assert_safe(FaultCode.REFERENCE_LINK_LOST, began_ns, SESSION_END_S)


@pytest.mark.parametrize("hours", [-1, 1])
def test_case_11_a_sender_whose_clock_is_an_hour_off_moves_the_valves_bit_by_bit_alike(hours: int) -> None:
    def restamped(datagrams: list[bytes]) -> list[bytes]:
        sound = [decode(data) for data in datagrams]
        shift_ns = hours * 3_600_000_000_000
        return [encode(d.message, d.header._replace(sent_ns=d.header.sent_ns + shift_ns)) for d in sound]

    exact, off = FaultRig().moving(), FaultRig(wire=restamped).moving()
    for rig in (exact, off):
        rig.assert_completes()
    assert [row.image for row in exact.registers.written] == [row.image for row in off.registers.written]


def test_case_18_a_second_source_is_ignored_and_told() -> None:
    alone, pestered = FaultRig().enabled(), FaultRig().enabled()
    server = pestered.world.controller._server
    intruder = ReferenceClient(nonce=1234, state_period_ms=5)
    intruder.connect(pestered.now_ns)
    copied: list[bytes] = []
    told: list[str] = []
    batch = server.receive_batch

    def with_intruder(datagrams: list[tuple[bytes, object]], now_ns: int) -> list[object]:
        intruder.tick(now_ns)
        copied.extend(data for data, _ in datagrams)
        foreign = [*intruder.outgoing(now_ns), *copied[-3:]]  # its own, and what it has overheard
        events = batch([*((data, "intruder") for data in foreign), *datagrams], now_ns)
        told.extend(event.cause for event in events if hasattr(event, "cause"))
        return events  # type: ignore[return-value]

    server.receive_batch = with_intruder  # type: ignore[method-assign,assignment]
    outgoing = server.outgoing
    server.outgoing = lambda now_ns=None: [  # type: ignore[method-assign]
        sent for sent in outgoing(now_ns) if sent[1] != "intruder"
    ]
    for rig in (alone, pestered):
        assert rig.ask(ReferencePose(0, rig.shifted(y=0.1), 0.0)).reason is Reason.ACCEPTED
        rig.run(1.0)
    assert [row.image for row in alone.registers.written] == [row.image for row in pestered.registers.written]
    assert {"session.occupied", "session.wrong_source"} <= set(told)
    assert pestered.state.references_dropped > 100  # the alarm that vision sees
