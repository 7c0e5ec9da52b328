"""Opening, closing and restarting sessions on a wire that delays, loses, repeats and reorders."""

import pytest

from protocol.client_session import ReferenceClient
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Command,
    ReferencePose,
)
from protocol.session_events import (
    SessionClosed,
    SessionLost,
)
from tests.protocol.wire import (
    BOOT,
    MS,
    TIMEOUT_MS,
    Wire,
    a_server,
    answers,
)

STOP = Command(0, CommandCode.STOP)
MOVE = ReferencePose(0, IDENTITY, 1.0)


class TestHandshake:
    @pytest.mark.parametrize("lost", [1, 3, 25])
    def test_survives_the_loss_of_the_first_hellos(self, lost: int) -> None:
        wire = Wire()
        wire.loses = lambda direction, data: direction == "up" and len(wire.sent_up) <= lost
        wire.client.connect(wire.now_ns)
        wire.run(100 * lost + 50)
        assert wire.client.connected
        assert wire.server.statistics.lost == 0

    @pytest.mark.parametrize("blind_ms", [150, 700, 3000])
    def test_survives_the_loss_of_the_first_welcomes(self, blind_ms: int) -> None:
        wire = Wire(server=a_server(link_timeout_ms=80))
        until_ns = wire.now_ns + blind_ms * MS
        wire.loses = lambda direction, data: direction == "down" and wire.now_ns < until_ns
        wire.client.connect(wire.now_ns)
        wire.run(blind_ms + 1200)
        assert wire.client.connected
        assert wire.server.link_alive(wire.server_ns)


class TestClosing:
    def test_a_clock_that_goes_back_does_not_keep_a_silent_link_alive(self) -> None:
        wire = Wire().connect().run(500)
        back_ns = wire.server_ns - 10_000 * MS
        assert wire.server.tick(back_ns) == []
        assert wire.server.tick(back_ns + TIMEOUT_MS * MS) == []
        assert [type(event) for event in wire.server.tick(back_ns + TIMEOUT_MS * MS + 1)] == [SessionClosed]


class TestRestarts:
    def test_a_restarted_controller_says_so_and_executes_nothing_of_the_time_before(self) -> None:
        wire = Wire(answer=None).connect()
        asked = wire.client.submit(MOVE, wire.now_ns)
        wire.run(10)
        assert len(wire.requests()) == 1
        wire.server = a_server(boot_id=BOOT + 1)
        wire.run(100)
        assert len(wire.requests()) == 1
        assert wire.client_events[-1] == SessionLost(Reason.UNKNOWN_SESSION, (asked,))
        assert not wire.client.connected
        wire.connect().run(100)
        assert len(wire.requests()) == 1
        assert wire.client.welcome is not None
        assert wire.client.welcome.boot_id == BOOT + 1

    def test_connecting_anew_gives_the_old_session_and_its_requests_up(self) -> None:
        wire = Wire(answer=None).connect()
        wire.client.submit(MOVE, wire.now_ns)
        wire.run(10)
        assert len(wire.requests()) == 1
        wire.connect().run(300)
        assert len(wire.requests()) == 1
        assert answers(wire) == []
        assert wire.client.connected

    def test_ids_of_two_runs_of_a_client_differ(self) -> None:
        def first_id(nonce: int) -> int:
            wire = Wire(client=ReferenceClient(nonce)).connect()
            return wire.client.submit(STOP, wire.now_ns)

        assert first_id(7) != first_id(8)
        assert first_id(2**64 - 1) < 2**53
