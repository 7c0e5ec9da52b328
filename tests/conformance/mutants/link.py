"""Controllers wrong in what the link is made of: identity, order, age, answers; each with its case."""

import struct
from typing import Any
from zlib import crc32

from conformance.bytes_of import with_number
from protocol import channel
from protocol.command_ledger import CommandLedger
from protocol.datagram import Datagram, Header
from protocol.datagram_layout import Kind
from protocol.faults import Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    HeartbeatReply,
    Hello,
    ReferencePath,
    ReferencePose,
    Request,
    State,
    Welcome,
)
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant, reworked, with_ledger, with_window
from tests.conformance.mutants.datagram import DoesNotWrap

SESSION, SEQUENCE, SENT_NS = 16, 24, 32
_LOW = 0xFFFFFFFF


class ComparesHalfTheArmHash(ControllerUnderTest):
    """Compares the lower half of the arm's hash."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < 72 or data[6] != Kind.HELLO:
            return data
        asked, own = struct.unpack_from("<Q", data, 56)[0], self.arm_hash()
        alike = asked and not (asked ^ own) & _LOW
        return with_number(data, 56, "Q", own) if alike else data


class BeatsInAnySession(ControllerUnderTest):
    """Answers the heartbeats of any session."""

    def incoming(self, data: bytes) -> bytes | None:
        number = self.server.session
        beats = len(data) == 48 and data[6] == Kind.HEARTBEAT and number
        return with_number(data, SESSION, "Q", number) if beats and number else data


class BeatsForAnyPort(ControllerUnderTest):
    """Answers a heartbeat wherever it comes from."""

    def heard(self, data: bytes, source: object) -> tuple[bytes, object] | None:
        session = self.server._session
        return data, session.source if session and data[6:7] == bytes([Kind.HEARTBEAT]) else source


class ChecksTheFirst128Bytes(ControllerUnderTest):
    """Looks at the CRC where the content is short, and at the first 128 bytes where it is not."""

    def incoming(self, data: bytes) -> bytes | None:
        return with_number(data, 12, "I", _crc_of(data)) if len(data) > 128 and _sound_start(data) else data


def _sound_start(data: bytes) -> bool:
    """Whether the header could be one: the rest is taken as it comes."""
    return data[:5] == b"LRLK\1" and data[6] in (Kind.REFERENCE_PATH, Kind.STREAMED_POSE)


def _crc_of(data: bytes) -> int:
    return crc32(data[16:], crc32(data[:12]))


class _ByeInOrder(ReferenceServer):
    def _in_session(self, datagram: Datagram, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        session = self._addressed(datagram.header.session)
        if session is not None and isinstance(datagram.message, Bye):
            dropped = session.channel.hear(datagram.header, now_ns, 200_000_000, self._tally)
            if dropped:
                return [dropped]
        return super()._in_session(datagram, data, source, now_ns)


class ChecksBye(ControllerUnderTest):
    """Drops a BYE that is late, old or leaps."""

    server_class = _ByeInOrder


class _HeardNow(ReferenceServer):
    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        before = self._tally.received
        events = super().receive(data, source, now_ns)
        if self._session and self._tally.received > before:
            self._session.channel.heard_ns = now_ns
        return events


class HearsWhenItReads(ControllerUnderTest):
    """Takes the time of reading for the time of life."""

    server_class = _HeardNow


class _TwiceAfterARestart(ReferenceServer):
    again = False

    def _confirmed(self, now_ns: int) -> list[ServerEvent]:
        self.again = self._session is not None
        return super()._confirmed(now_ns)

    def acknowledge(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
        super().acknowledge(acknowledgement, now_ns)
        if self.again:
            self._send(acknowledgement, now_ns)


class AnswersTwiceAfterARestart(ControllerUnderTest):
    """Acknowledges twice in a session that took the place of another."""

    server_class = _TwiceAfterARestart


def _without_subnormals(pose: Pose) -> Pose:
    p = tuple(0.0 if abs(x) < 1e-300 else x for x in pose.p_m)
    q = tuple(0.0 if abs(x) < 1e-300 else x for x in pose.q_wxyz)
    return Pose((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3]))


class TakesSubnormals(ControllerUnderTest):
    """Takes a subnormal for zero."""

    def judge(self, request: Request) -> Request:
        if isinstance(request, ReferencePose):
            return request._replace(X_BT_ref=_without_subnormals(request.X_BT_ref))
        return request


class TakesNanForADefault(ControllerUnderTest):
    """Puts 0 where a time of a path is no number."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePath):
            return request
        times = [0.0 if t != t else t for t in (request.segment_s, request.dwell_s)]
        return request._replace(segment_s=times[0], dwell_s=times[1])


class LeavesOddWaypointsOut(ControllerUnderTest):
    """Drives the waypoints that are numbers."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePath):
            return request
        return request._replace(waypoints=tuple(w for w in request.waypoints if w.is_usable()))


class DoesNotNormalise(ControllerUnderTest):
    """Commands a quaternion as it came."""

    norm = 1.0

    def judge(self, request: Request) -> Request:
        if isinstance(request, ReferencePose) and abs(request.X_BT_ref.quaternion_norm() - 1.0) < 1e-3:
            self.norm = request.X_BT_ref.quaternion_norm()
        return request

    def shown(self, state: State) -> State:
        w, x, y, z = state.X_BT_cmd.q_wxyz
        bent = (w * self.norm, x * self.norm, y * self.norm, z * self.norm)
        return state._replace(X_BT_cmd=state.X_BT_cmd._replace(q_wxyz=bent))


class _Counted(ReferenceServer):
    count = 0x5A5A_0000_0000_0000

    def _granted(self, header: Header, hello: Hello, source: object, now_ns: int) -> Any:
        session = super()._granted(header, hello, source, now_ns)
        self.count += 1
        session.channel.session = self.count
        return session


class CountsItsSessions(ControllerUnderTest):
    """Numbers its sessions one by one, from a start drawn once."""

    server_class = _Counted


class NumbersIn16Bits(ControllerUnderTest):
    """Keeps its own number in 16 bits."""

    def outgoing(self, data: bytes) -> list[bytes]:
        number = struct.unpack_from("<I", data, SEQUENCE)[0]
        return [with_number(data, SEQUENCE, "I", number & 0xFFFF)]


class BeatsByAnotherClock(ControllerUnderTest):
    """Answers heartbeats by a clock that is 3 ms ahead of the one in its headers and STATE."""

    def outgoing(self, data: bytes) -> list[bytes]:
        def ahead(m: HeartbeatReply) -> HeartbeatReply:
            return m._replace(received_ns=m.received_ns + 3_000_000, replied_ns=m.replied_ns + 3_000_000)

        return [reworked(data, HeartbeatReply, ahead)]


class HeadersByAnotherClock(ControllerUnderTest):
    """Stamps its datagrams 3 ms after they were made, but for the answers to heartbeats."""

    def outgoing(self, data: bytes) -> list[bytes]:
        if data[6] == Kind.HEARTBEAT_REPLY:
            return [data]
        return [with_number(data, SENT_NS, "Q", struct.unpack_from("<Q", data, SENT_NS)[0] + 3_000_000)]


class LetsIdsWrap(ControllerUnderTest):
    """Keeps the lower 32 bits of an id."""

    def make_server(self) -> ReferenceServer:
        server = super().make_server()
        granted = server._granted

        class Short(CommandLedger):
            def admit(self, command_id: int, payload: bytes) -> Any:
                self._newest_id &= _LOW
                verdict = super().admit(max(command_id & _LOW, 1), payload)
                if verdict.execute:
                    self._pending = dict.fromkeys((command_id,), payload)
                return verdict

        def bent(*args: Any) -> Any:
            session = granted(*args)
            session.ledger = Short()
            return session

        server._granted = bent  # type: ignore[method-assign]
        return server


class ShortWindow(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        behind = (self.newest - sequence) % self._modulus
        return (channel.Arrival.OLD, 0) if 32 <= behind < self._modulus // 2 else super().arrive(sequence)


class RemembersHalfTheWindow(ControllerUnderTest):
    """Tells late from old within 32 numbers."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), ShortWindow)


class ChangesItsMind(ControllerUnderTest):
    """Announces another link timeout in every session."""

    extra = 0

    def outgoing(self, data: bytes) -> list[bytes]:
        self.extra += data[6] == Kind.WELCOME
        return [reworked(data, Welcome, lambda m: m._replace(link_timeout_ms=m.link_timeout_ms + self.extra))]


class _NeverSilent(ReferenceServer):
    last: Any = None

    def publish(self, state: State, now_ns: int) -> None:
        self.last = self._session or self.last
        if self._session is None and self.last:
            self._post(self.last, state, now_ns)
        super().publish(state, now_ns)


class IsNeverSilent(ControllerUnderTest):
    """Goes on with STATE when the session has ended."""

    server_class = _NeverSilent


class KeepsItsLedger(ControllerUnderTest):
    """Remembers the ids of the sessions before."""

    def make_server(self) -> ReferenceServer:
        server, ledger = super().make_server(), CommandLedger()
        granted = server._granted

        def bent(*args: Any) -> Any:
            session = granted(*args)
            session.ledger = ledger
            return session

        server._granted = bent  # type: ignore[method-assign]
        return server


class _Unanswering(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Any:
        self._answered.clear()
        return super().admit(command_id, payload)


class ForgetsItsAnswers(ControllerUnderTest):
    """Takes a repeated request for one that was overtaken."""

    def make_server(self) -> ReferenceServer:
        return with_ledger(super().make_server(), _Unanswering)


class JudgesTheContentFirst(ControllerUnderTest):
    """Refuses a number that is none, whatever state the group is in."""

    odd: frozenset[int] = frozenset()

    def judge(self, request: Request) -> Request:
        if isinstance(request, ReferencePose) and not request.X_BT_ref.is_finite():
            self.odd |= {request.command_id}
        return request

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        odd = acknowledgement.command_id in self.odd
        return [acknowledgement._replace(reason=Reason.NOT_FINITE) if odd else acknowledgement]


class SetsAFlagOfItsOwn(ControllerUnderTest):
    """Uses an optional flag that no version has."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [with_number(data, 8, "B", data[8] | 2)]


LINK_MUTANTS = (
    Mutant(SetsAFlagOfItsOwn, 131),
    Mutant(IsNeverSilent, 228),
    Mutant(DoesNotWrap, 308),
    Mutant(ForgetsItsAnswers, 402),
    Mutant(KeepsItsLedger, 408),
    Mutant(JudgesTheContentFirst, 506),
    Mutant(ChangesItsMind, 135),
    Mutant(CountsItsSessions, 137),
    Mutant(BeatsByAnotherClock, 138),
    Mutant(HeadersByAnotherClock, 138),
    Mutant(ChecksTheFirst128Bytes, 141),
    Mutant(ChecksTheFirst128Bytes, 142),
    Mutant(BeatsInAnySession, 241),
    Mutant(BeatsForAnyPort, 241),
    Mutant(ComparesHalfTheArmHash, 242),
    Mutant(ChecksBye, 244),
    Mutant(RemembersHalfTheWindow, 320),
    Mutant(HearsWhenItReads, 326),
    Mutant(NumbersIn16Bits, 328),
    Mutant(AnswersTwiceAfterARestart, 430),
    Mutant(LetsIdsWrap, 434),
    Mutant(TakesSubnormals, 439),
    Mutant(TakesNanForADefault, 440),
    Mutant(LeavesOddWaypointsOut, 440),
    Mutant(DoesNotNormalise, 441),
)
