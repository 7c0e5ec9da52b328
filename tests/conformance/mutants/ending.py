"""Controllers that go on when their client has gone, or make too much of it, each caught by its own case."""

from controller.core.inbox import Inbox
from controller.core.requests import react_to_fault
from controller.core.supervision import Fault
from protocol.axes_group import Mode
from protocol.faults import FaultCode, Reason
from protocol.reference_messages import Acknowledgement
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent, SessionClosed
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant
from tests.conformance.mutants.handshake import EndsTheOldAtHello


class _Unaware(Inbox):
    unaware_of: tuple[Reason, ...] = (Reason.PEER_RESTARTED,)

    def put(self, events: list[ServerEvent]) -> list[Acknowledgement]:
        kept = [e for e in events if not (isinstance(e, SessionClosed) and e.reason in self.unaware_of)]
        return super().put(kept)


class MotionSurvivesRestart(ControllerUnderTest):
    """Takes the new session of the same client for the old one."""

    def make_inbox(self) -> Inbox:
        return _Unaware()


class _UnawareOfBye(_Unaware):
    unaware_of = (Reason.SHUTDOWN,)


class MotionSurvivesBye(ControllerUnderTest):
    """Goes on until the link has been silent, whatever its client has said."""

    def make_inbox(self) -> Inbox:
        return _UnawareOfBye()

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            gone_ns: int | None = None

            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                events = super().receive(data, source, now_ns)
                if any(isinstance(event, SessionClosed) for event in events):
                    self.gone_ns = now_ns
                return events

            def link_alive(self, now_ns: int) -> bool:
                heard = self.gone_ns is not None and now_ns - self.gone_ns < LINK_TIMEOUT_MS * 1_000_000
                return heard or super().link_alive(now_ns)

        return Server(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, key=self.link_key)


class _Latching(ControllerUnderTest):
    """Latches a fault for a client that has gone, in modes in which nothing is wrong."""

    in_mode: Mode

    def _scan(self) -> None:
        if self.inbox._last_words is not None and self.bench.state.mode is self.in_mode:
            lost = Fault(FaultCode.REFERENCE_LINK_LOST, 0.0, 0.0)
            self.bench.state, _ = react_to_fault(self.settings, self.bench.state, lost)
        super()._scan()


class LatchesInStandby(_Latching):
    """Takes a client that leaves in STANDBY for a fault."""

    in_mode = Mode.STANDBY


class LatchesWhileStopping(_Latching):
    """Takes a client that leaves while STOPPING for a fault."""

    in_mode = Mode.STOPPING


ENDING_MUTANTS = (
    Mutant(MotionSurvivesBye, 534),
    Mutant(MotionSurvivesRestart, 535),
    Mutant(EndsTheOldAtHello, 536),
    Mutant(MotionSurvivesBye, 537),
    Mutant(LatchesInStandby, 537),
    Mutant(MotionSurvivesRestart, 538),
    Mutant(LatchesInStandby, 538),
    Mutant(MotionSurvivesBye, 539),
    Mutant(LatchesWhileStopping, 539),
)
