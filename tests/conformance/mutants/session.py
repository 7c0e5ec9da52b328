"""Controllers wrong in who is served, for how long, and what is sent unasked; each with its case."""

import struct
from typing import Any

from protocol.datagram import Header, decode
from protocol.faults import Reason
from protocol.reference_messages import (
    Bye,
    Hello,
    State,
    Welcome,
)
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import HEADER_BYTES, Mutant, reworked


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


class IgnoresTheStatePeriod(ControllerUnderTest):
    """Sends STATE every cycle."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def publish(self, state: State, now_ns: int) -> None:
                if self._session:
                    self._session.next_state_ns = now_ns
                super().publish(state, now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


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


SESSION_MUTANTS = (
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
    Mutant(IgnoresTheStatePeriod, 411),
    Mutant(GoesOnUnattended, 529),
)
