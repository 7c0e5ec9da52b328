"""Controllers that begin or end sessions at the wrong datagram, each caught by the case meant for it."""

from typing import Any

from protocol.datagram import Header, decode
from protocol.faults import Reason
from protocol.reference_messages import Heartbeat, Hello, Welcome
from protocol.server_session import ReferenceServer
from protocol.session_events import DatagramDropped, ServerEvent
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant


class _BeginsWithHello(ReferenceServer):
    def _greeted(self, header: Header, hello: Hello, source: object, now_ns: int) -> list[ServerEvent]:
        events = super()._greeted(header, hello, source, now_ns)
        return events + (self._confirmed(now_ns) if self._unconfirmed else [])


class BeginsWithHello(ControllerUnderTest):
    """Opens the session with HELLO, whoever sent it."""

    server_class = _BeginsWithHello


class _EndsAtHello(ReferenceServer):
    def _greeted(self, header: Header, hello: Hello, source: object, now_ns: int) -> list[ServerEvent]:
        events = super()._greeted(header, hello, source, now_ns)
        return events + (self.close(now_ns, Reason.PEER_RESTARTED) if self._unconfirmed else [])


class EndsTheOldAtHello(ControllerUnderTest):
    """Ends the session in use when its client seems to come back, before the new one has begun."""

    server_class = _EndsAtHello


class _NeverEndsTheOld(ReferenceServer):
    def _in_session(self, datagram: Any, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        number, old = datagram.header.session, self._session
        begun = self._unconfirmed and number == self._unconfirmed.channel.session
        events = super()._in_session(datagram, data, source, now_ns)
        if begun and old:
            self._unconfirmed = old
            old.greeted_ns = now_ns
        return events


class LetsTheOldLiveOn(ControllerUnderTest):
    """Goes on with the old session beside the new one."""

    server_class = _NeverEndsTheOld


class _BothGrantsStand(ReferenceServer):
    first: Any = None

    def _granted(self, header: Header, hello: Hello, source: object, now_ns: int) -> Any:
        self.first = self._unconfirmed
        return super()._granted(header, hello, source, now_ns)

    def _addressed(self, number: int) -> Any:
        if self.first and self.first.channel.session == number:
            self._unconfirmed, self.first = self.first, None
        return super()._addressed(number)


class KeepsEveryGrant(ControllerUnderTest):
    """Begins a session whose grant was replaced by another."""

    server_class = _BothGrantsStand


class _GrantsForEver(ReferenceServer):
    def tick(self, now_ns: int) -> list[ServerEvent]:
        if self._unconfirmed:
            self._unconfirmed.greeted_ns = now_ns
        return super().tick(now_ns)


class GrantsForEver(ControllerUnderTest):
    """Does not forget a grant."""

    server_class = _GrantsForEver


class _GrantsForHalf(ReferenceServer):
    def tick(self, now_ns: int) -> list[ServerEvent]:
        granted = self._unconfirmed
        if granted and now_ns - granted.greeted_ns > LINK_TIMEOUT_MS * 500_000:
            self._unconfirmed = None
        return super().tick(now_ns)


class GrantsForHalf(ControllerUnderTest):
    """Forgets a grant after half the time."""

    server_class = _GrantsForHalf


class _BeginsWithAHeartbeat(ReferenceServer):
    def _in_session(self, datagram: Any, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        granted = self._unconfirmed
        named = granted and datagram.header.session == granted.channel.session
        if named and not isinstance(datagram.message, Heartbeat):
            return [self._foreign("session.unknown", "no heartbeat yet")]
        return super()._in_session(datagram, data, source, now_ns)


class BeginsWithAHeartbeatOnly(ControllerUnderTest):
    """Does not use a request before the first heartbeat."""

    server_class = _BeginsWithAHeartbeat


class WelcomesFourTimes(ControllerUnderTest):
    """Sends WELCOME four times, lest it be lost."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [data] * (4 if isinstance(decode(data).message, Welcome) else 1)


class _GrantOccupies(ReferenceServer):
    def _greeted(self, header: Header, hello: Hello, source: object, now_ns: int) -> list[ServerEvent]:
        if self._unconfirmed and source != self._unconfirmed.source:
            self._refuse(Reason.SESSION_OCCUPIED, 0, source, now_ns)
            return []
        return super()._greeted(header, hello, source, now_ns)


class GrantOccupies(ControllerUnderTest):
    """Refuses others while a grant has not begun."""

    server_class = _GrantOccupies


class _RefusalEnds(ReferenceServer):
    cause = "session.wrong_arm"

    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        events = super().receive(data, source, now_ns)
        refused = any(isinstance(event, DatagramDropped) and event.cause == self.cause for event in events)
        return events + (self.close(now_ns) if refused else [])


class WrongArmEndsTheSession(ControllerUnderTest):
    """Takes HELLO for another arm for the end of its client's session."""

    server_class = _RefusalEnds


class _VersionEnds(_RefusalEnds):
    cause = "datagram.wrong_major"


class WrongVersionEndsTheSession(ControllerUnderTest):
    """Takes a datagram of another major version for the end of the session."""

    server_class = _VersionEnds


HANDSHAKE_MUTANTS = (
    Mutant(BeginsWithHello, 231),
    Mutant(BeginsWithHello, 232),
    Mutant(BeginsWithHello, 237),
    Mutant(EndsTheOldAtHello, 232),
    Mutant(EndsTheOldAtHello, 233),
    Mutant(LetsTheOldLiveOn, 233),
    Mutant(KeepsEveryGrant, 234),
    Mutant(GrantsForEver, 235),
    Mutant(GrantsForHalf, 235),
    Mutant(BeginsWithAHeartbeatOnly, 236),
    Mutant(WelcomesFourTimes, 237),
    Mutant(GrantOccupies, 238),
    Mutant(WrongArmEndsTheSession, 239),
    Mutant(WrongVersionEndsTheSession, 239),
)
