"""Controllers that see a repetition, or a newer request, where there is none, each caught by its own case."""

from typing import Any

from conformance.bytes_of import resealed
from controller.core.inbox import Inbox
from protocol.datagram_layout import HEADER_BYTES, Kind
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, ReferencePose, Request
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant, reworked

KIND, SENT, OWN_SENT = 6, slice(32, 40), slice(40, 48)


class ComparesPadding(ControllerUnderTest):
    """Compares a repetition with the request byte for byte."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            data = b""

            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                self.data = data
                return super().receive(data, source, now_ns)

            def _requested(self, session: Any, request: Any, _: bytes, now_ns: int) -> list[ServerEvent]:
                return super()._requested(session, request, self.data[HEADER_BYTES:], now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS)


class _FallsBack(Inbox):
    def _enter(self, request: Request) -> list[Acknowledgement]:
        if isinstance(request, ReferencePose) and abs(request.X_BT_ref.p_m[2]) > 100.0:
            self._waiting.append(request)
            return []
        return super()._enter(request)


class FallsBackToTheGoodOne(ControllerUnderTest):
    """Takes the newest reference that can be followed, not the newest."""

    def make_inbox(self) -> Inbox:
        return _FallsBack()


class OvertakenByNobody(ControllerUnderTest):
    """Does not say what has overtaken a request."""

    def outgoing(self, data: bytes) -> list[bytes]:
        def nameless(answer: Acknowledgement) -> Acknowledgement:
            overtaken = answer.reason is Reason.OVERTAKEN
            return answer._replace(value=0.0, limit=0.0) if overtaken else answer

        return [reworked(data, Acknowledgement, nameless)]


class RepeatsTheHeadersTime(ControllerUnderTest):
    """Answers HEARTBEAT with the time of its header."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < OWN_SENT.stop or data[KIND] != Kind.HEARTBEAT:
            return data
        return resealed(data[: OWN_SENT.start] + data[SENT] + data[OWN_SENT.stop :])


REPETITION_MUTANTS = (
    Mutant(ComparesPadding, 419),
    Mutant(FallsBackToTheGoodOne, 420),
    Mutant(OvertakenByNobody, 421),
    Mutant(RepeatsTheHeadersTime, 422),
)
