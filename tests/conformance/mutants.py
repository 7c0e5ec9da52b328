"""Controllers with one thing wrong each, and the cases meant to catch them."""

import struct
from typing import Any, NamedTuple

from conformance.bytes_of import resealed, with_number
from protocol import channel
from protocol.command_ledger import CommandLedger, Verdict
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import Kind
from protocol.errors import DatagramRefused
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
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
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest

MAJOR, MINOR, FLAGS, LENGTH, SEQUENCE, ECHO, HEADER_BYTES = 4, 5, 8, 10, 24, 28, 40


def reworked(data: bytes, kind: type, rework: Any) -> bytes:
    """``data`` with its message replaced by ``rework(message)`` if it is of ``kind``."""
    header, message = decode(data)
    return encode(rework(message), header) if isinstance(message, kind) else data


class NoCrc(ControllerUnderTest):
    """Does not look at the CRC."""

    def incoming(self, data: bytes) -> bytes | None:
        return resealed(data) if len(data) >= HEADER_BYTES else data


class NoMagic(ControllerUnderTest):
    """Does not look at the magic."""

    def incoming(self, data: bytes) -> bytes | None:
        return resealed(b"LRLK" + data[4:]) if len(data) >= HEADER_BYTES and _sound_crc(data) else data


class IgnoresTrailingBytes(ControllerUnderTest):
    """Reads what the length field says and leaves the rest."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < HEADER_BYTES:
            return data
        wanted = HEADER_BYTES + struct.unpack_from("<H", data, LENGTH)[0]
        return resealed(data[:wanted]) if len(data) > wanted else data


class FillsUpShortDatagrams(ControllerUnderTest):
    """Takes the missing bytes of a COMMAND for zero."""

    def incoming(self, data: bytes) -> bytes | None:
        if not HEADER_BYTES <= len(data) < 56 or data[6] != Kind.COMMAND:
            return data
        return with_number(data + bytes(56 - len(data)), LENGTH, "H", 16)


class IgnoresCriticalFlags(ControllerUnderTest):
    """Ignores every flag."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < HEADER_BYTES or not _sound_crc(data):
            return data
        return with_number(data, FLAGS, "H", data[FLAGS])


class IgnoresTheMajorVersion(ControllerUnderTest):
    """Takes any major version for its own."""

    def incoming(self, data: bytes) -> bytes | None:
        return with_number(data, MAJOR, "B", 1) if len(data) >= HEADER_BYTES and _sound_crc(data) else data


class DropsUnknownCommands(ControllerUnderTest):
    """Leaves an unknown command without an answer."""

    def incoming(self, data: bytes) -> bytes | None:
        try:
            message = decode(data).message
        except DatagramRefused:
            return data
        return None if type(message).__name__ == "UnusableRequest" else data


class _Forgetful(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        self.__init__()
        return super().admit(command_id, payload)


class ExecutesRepetitions(ControllerUnderTest):
    """Forgets which commands it has executed."""

    def make_server(self) -> ReferenceServer:
        server = super().make_server()
        return _with_ledger(server, _Forgetful)


class _LetsOlderIdsPass(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        if command_id not in self._answered and command_id not in self._pending:
            self._newest_id = 0
        return super().admit(command_id, payload)


class LetsMotionsOvertake(ControllerUnderTest):
    """Executes an id below the newest."""

    def make_server(self) -> ReferenceServer:
        return _with_ledger(super().make_server(), _LetsOlderIdsPass)


class _ById(CommandLedger):
    def admit(self, command_id: int, payload: bytes) -> Verdict:
        return super().admit(command_id, b"")


class LooksAtTheIdAlone(ControllerUnderTest):
    """Takes any request with a known id for a repetition."""

    def make_server(self) -> ReferenceServer:
        return _with_ledger(super().make_server(), _ById)


class AnswersTwice(ControllerUnderTest):
    """Sends every acknowledgement twice, under two sequence numbers."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def acknowledge(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
                super().acknowledge(acknowledgement, now_ns)
                self._send(acknowledgement, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class _AnyOrder(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        arrival, _ = super().arrive(sequence)
        self.newest = sequence
        return (arrival if arrival is channel.Arrival.DUPLICATE else channel.Arrival.NEW), 0


class _Plain(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        if sequence <= self.newest:
            return channel.Arrival.OLD, 0
        skipped, self.newest = sequence - self.newest - 1, sequence
        return channel.Arrival.NEW, skipped


class _NoDuplicates(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        arrival, skipped = super().arrive(sequence)
        return (channel.Arrival.NEW if arrival is channel.Arrival.DUPLICATE else arrival), skipped


class _AnyLeap(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        if 0 < (sequence - self.newest) % 2**32 < 2**31:
            self.newest = sequence
            return channel.Arrival.NEW, 0
        return super().arrive(sequence)


class UsesLateDatagrams(ControllerUnderTest):
    """Drops duplicates only."""

    def make_server(self) -> ReferenceServer:
        return _with_window(super().make_server(), _AnyOrder)


class DoesNotWrap(ControllerUnderTest):
    """Compares sequence numbers as plain numbers."""

    def make_server(self) -> ReferenceServer:
        return _with_window(super().make_server(), _Plain)


class UsesDuplicates(ControllerUnderTest):
    """Drops older numbers, but not the same again."""

    def make_server(self) -> ReferenceServer:
        return _with_window(super().make_server(), _NoDuplicates)


class FollowsAnyLeap(ControllerUnderTest):
    """Follows a leap of any size."""

    def make_server(self) -> ReferenceServer:
        return _with_window(super().make_server(), _AnyLeap)


class UsesStaleDatagrams(ControllerUnderTest):
    """Judges by sequence alone."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, max_age_ms=10**6)


class WaitsTooLong(ControllerUnderTest):
    """Ends a silent session after twice the time it announced."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, 2 * LINK_TIMEOUT_MS)

    def outgoing(self, data: bytes) -> list[bytes]:
        return [reworked(data, Welcome, lambda m: m._replace(link_timeout_ms=LINK_TIMEOUT_MS))]


class IsImpatient(ControllerUnderTest):
    """Ends a session after two thirds of the time it announced."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [reworked(data, Welcome, lambda m: m._replace(link_timeout_ms=LINK_TIMEOUT_MS * 3 // 2))]


class LeavesInSilence(ControllerUnderTest):
    """Ends a session without a word."""

    def outgoing(self, data: bytes) -> list[bytes]:
        message = decode(data).message
        return [] if message == Bye(Reason.LINK_TIMEOUT) else [data]


class TakesASecondClient(ControllerUnderTest):
    """Lets the newest client in, whoever is connected."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                if self._session and len(data) > 6 and data[6] == 1:
                    self._session.source = source
                return super().receive(data, source, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class TakesAnySource(ControllerUnderTest):
    """Uses a datagram of the session wherever it comes from."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                if self._session and len(data) > 6 and data[6] != 1:
                    source = self._session.source
                return super().receive(data, source, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class OpensForRecordedHellos(ControllerUnderTest):
    """Does not remember nonces."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                self._past_nonces.clear()
                return super().receive(data, source, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class GrantsEverything(ControllerUnderTest):
    """Grants every capability it is asked for."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, capabilities=2**64 - 1)


class GrantsUnasked(ControllerUnderTest):
    """Grants what was not offered."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [reworked(data, Welcome, lambda m: m._replace(capabilities=1))]


class AnswersEveryStranger(ControllerUnderTest):
    """Does not ration its refusals."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                self._refused_at_ns = None
                return super().receive(data, source, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class AnswersBye(ControllerUnderTest):
    """Answers BYE with BYE."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                events = super().receive(data, source, now_ns)
                if len(data) > 6 and data[6] == 10:
                    self._refuse(Reason.UNKNOWN_SESSION, 0, source, now_ns)
                return events

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class NumbersFromAByte(ControllerUnderTest):
    """Keeps its own sequence number in one byte."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, first_sequence=250)

    def outgoing(self, data: bytes) -> list[bytes]:
        return [with_number(data, SEQUENCE, "I", struct.unpack_from("<I", data, SEQUENCE)[0] & 0xFF)]


class EchoesTheFirst(ControllerUnderTest):
    """Echoes a number that is not the newest."""

    def outgoing(self, data: bytes) -> list[bytes]:
        echo = struct.unpack_from("<I", data, ECHO)[0]
        return [with_number(data, ECHO, "I", max(echo - 1, 0))]


class StampsInMicroseconds(ControllerUnderTest):
    """Answers heartbeats in microseconds."""

    def outgoing(self, data: bytes) -> list[bytes]:
        def coarse(m: HeartbeatReply) -> HeartbeatReply:
            return m._replace(received_ns=m.received_ns // 1000, replied_ns=m.replied_ns // 1000)

        return [reworked(data, HeartbeatReply, coarse)]


class StampsBackwards(ControllerUnderTest):
    """Claims to have replied before it received."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [reworked(data, HeartbeatReply, lambda m: m._replace(received_ns=m.replied_ns + 1000))]


class IgnoresTheStatePeriod(ControllerUnderTest):
    """Sends STATE every cycle."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def publish(self, state: State, now_ns: int) -> None:
                if self._session:
                    self._session.next_state_ns = now_ns
                super().publish(state, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class CountsNoLosses(ControllerUnderTest):
    """Shows no losses."""

    def shown(self, state: State) -> State:
        return state._replace(references_lost=0)


class TakesNanForZero(ControllerUnderTest):
    """Puts 0 where a NaN came."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePose):
            return request
        here = self.bench.last.view.X_BT_cmd
        sane = request.X_BT_ref if request.X_BT_ref.is_finite() else here
        duration = request.duration_s if abs(request.duration_s) < 1e6 else 0.0
        return request._replace(X_BT_ref=sane, duration_s=duration)


class NormalisesAnything(ControllerUnderTest):
    """Normalises every quaternion."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePose) or not 0.0 < request.X_BT_ref.quaternion_norm() < 9.0:
            return request
        norm = request.X_BT_ref.quaternion_norm()
        w, x, y, z = request.X_BT_ref.q_wxyz
        unit = (w / norm, x / norm, y / norm, z / norm)
        return request._replace(X_BT_ref=request.X_BT_ref._replace(q_wxyz=unit))


class DrivesTheReachablePart(ControllerUnderTest):
    """Leaves out the waypoints that cannot be reached."""

    def judge(self, request: Request) -> Request:
        if not isinstance(request, ReferencePath):
            return request
        near = tuple(w for w in request.waypoints if abs(w.p_m[2]) < 10.0)
        return request._replace(waypoints=near)


class ForgetsTheEmergency(ControllerUnderTest):
    """A new session clears the emergency stop."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) > 6 and data[6] == 1:
            self.bench.step(Command(1, CommandCode.EMERGENCY_RELEASE))
            self.bench.step(Command(2, CommandCode.RESET))
        return data


class ReleaseIsEnough(ControllerUnderTest):
    """EMERGENCY_RELEASE resets as well."""

    def judge(self, request: Request) -> Request:
        if isinstance(request, Command) and request.code is CommandCode.EMERGENCY_RELEASE:
            self.bench.step(request)
            return request._replace(code=CommandCode.RESET)
        return request


class GoesOnUnattended(ControllerUnderTest):
    """Does not tell the scan that the link is lost."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def link_alive(self, now_ns: int) -> bool:
                return True

            def tick(self, now_ns: int) -> list[ServerEvent]:
                if self._session and not super().link_alive(now_ns):
                    self.close(now_ns)
                return []

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class MoreMinor(ControllerUnderTest):
    """Sends another minor version than it negotiated."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [data if data[6] == 2 else with_number(data, MINOR, "B", 3)]


class KeepsItsSessionNumber(ControllerUnderTest):
    """Numbers its sessions by the client's nonce's parity: soon the same again."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def _granted(self, header: Header, hello: Hello, source: object, now_ns: int) -> Any:
                self._factory.count = 0
                return super()._granted(header, hello._replace(client_nonce=1), source, now_ns)

            def outgoing(self, now_ns: int | None = None) -> list[tuple[bytes, object]]:
                return [(reworked(d, Welcome, self._with_nonce), s) for d, s in super().outgoing(now_ns)]

            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                if len(data) > 48 and data[6] == 1:
                    self._nonce = struct.unpack_from("<Q", data, HEADER_BYTES)[0]
                    self._past_nonces.clear()
                return super().receive(data, source, now_ns)

            def _with_nonce(self, welcome: Welcome) -> Welcome:
                return welcome._replace(client_nonce=self._nonce)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class Mutant(NamedTuple):
    """A broken controller and the case that is meant to catch it."""

    make: type[ControllerUnderTest]
    case: int


MUTANTS = (
    Mutant(NoMagic, 102),
    Mutant(FillsUpShortDatagrams, 104),
    Mutant(IgnoresTrailingBytes, 107),
    Mutant(NoCrc, 109),
    Mutant(NoCrc, 111),
    Mutant(IgnoresTheMajorVersion, 112),
    Mutant(IgnoresTheMajorVersion, 113),
    Mutant(IgnoresCriticalFlags, 116),
    Mutant(DropsUnknownCommands, 123),
    Mutant(DropsUnknownCommands, 125),
    Mutant(KeepsItsSessionNumber, 202),
    Mutant(GrantsUnasked, 203),
    Mutant(GrantsEverything, 204),
    Mutant(OpensForRecordedHellos, 210),
    Mutant(TakesASecondClient, 211),
    Mutant(TakesAnySource, 218),
    Mutant(AnswersBye, 222),
    Mutant(AnswersEveryStranger, 223),
    Mutant(WaitsTooLong, 224),
    Mutant(LeavesInSilence, 224),
    Mutant(IsImpatient, 226),
    Mutant(MoreMinor, 229),
    Mutant(UsesDuplicates, 301),
    Mutant(UsesLateDatagrams, 302),
    Mutant(FollowsAnyLeap, 305),
    Mutant(DoesNotWrap, 307),
    Mutant(CountsNoLosses, 310),
    Mutant(NumbersFromAByte, 311),
    Mutant(EchoesTheFirst, 312),
    Mutant(UsesStaleDatagrams, 313),
    Mutant(UsesStaleDatagrams, 314),
    Mutant(StampsBackwards, 317),
    Mutant(StampsInMicroseconds, 318),
    Mutant(AnswersTwice, 401),
    Mutant(LooksAtTheIdAlone, 404),
    Mutant(LetsMotionsOvertake, 405),
    Mutant(IgnoresTheStatePeriod, 411),
    Mutant(ForgetsTheEmergency, 508),
    Mutant(ReleaseIsEnough, 509),
    Mutant(ExecutesRepetitions, 510),
    Mutant(TakesNanForZero, 521),
    Mutant(NormalisesAnything, 522),
    Mutant(DrivesTheReachablePart, 526),
    Mutant(GoesOnUnattended, 529),
)


def _sound_crc(data: bytes) -> bool:
    return data == resealed(data)


def _with_ledger(server: ReferenceServer, ledger: type[CommandLedger]) -> ReferenceServer:
    def granted(*args: Any) -> Any:
        session = original(*args)
        session.ledger = ledger()
        return session

    original = server._granted
    server._granted = granted
    return server


def _with_window(server: ReferenceServer, window: type[channel.SequenceWindow]) -> ReferenceServer:
    def granted(header: Header, *args: Any) -> Any:
        session = original(header, *args)
        session.channel._window = window(header.sequence)
        return session

    original = server._granted
    server._granted = granted
    return server
