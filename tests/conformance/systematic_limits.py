"""Each limit of clause 8 off by one and by two, to both sides, and each time twice and half as long.

While the controller computes, and only then, its own code finds another number where the limit stands.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import NamedTuple

from protocol.authentication import LinkKey
from protocol.reference_messages import Welcome
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.breaking import reworked
from tests.conformance.mutants.key import KEY

MS = 1_000_000


class Limit(NamedTuple):
    """A number that the code has: in which module, under which name; and the clause that says it."""

    what: str
    module: str
    name: str
    clause: str = "8"


COUNTS = (
    Limit("largest datagram", "protocol.datagram", "MAX_DATAGRAM_BYTES"),
    Limit("waypoints in a path", "protocol.datagram", "MAX_WAYPOINTS", "3.6"),
    Limit("requests that wait", "controller.core.inbox", "WAITING", "6.14"),
    Limit("answers remembered", "protocol.command_ledger", "REMEMBERED"),
    Limit("gap in the sequence", "protocol.channel", "MAX_GAP_DATAGRAMS"),
)
TIMES = (
    Limit("BYE to strangers", "protocol.server_session", "REFUSAL_INTERVAL_NS"),
    Limit("base of age", "protocol.channel", "BASE_WINDOW_NS", "5.3"),
)


class _Limited(ControllerUnderTest):
    """Has another number in the place of one of its limits."""

    def __init__(self, limit: Limit, value: float, key: LinkKey | None = None) -> None:
        self._limit, self._value, self.link_key = limit, value, key
        with self._other():
            super().__init__()

    def turn(self) -> None:
        with self._other():
            super().turn()

    @contextmanager
    def _other(self) -> Iterator[None]:
        module = import_module(self._limit.module)
        right = getattr(module, self._limit.name)
        setattr(module, self._limit.name, self._value)
        try:
            yield
        finally:
            setattr(module, self._limit.name, right)


def _window(size: int) -> type[ControllerUnderTest]:
    """A controller whose memory of numbers is of ``size``."""

    class OfAnotherWindow(_Limited):
        def __init__(self) -> None:
            super().__init__(Limit("", "protocol.channel", "WINDOW_DATAGRAMS"), size)

        @contextmanager
        def _other(self) -> Iterator[None]:
            import protocol.channel as channel

            right = channel._ALL_SEEN
            channel._ALL_SEEN = (1 << size) - 1
            try:
                with super()._other():
                    yield
            finally:
                channel._ALL_SEEN = right

    return OfAnotherWindow


class _Timed(ControllerUnderTest):
    """Counts with another link timeout, greatest age or state period than it announces."""

    def __init__(self, timeout: float = 1.0, max_age: float = 1.0, period: float = 1.0) -> None:
        self._timeout, self._max_age, self._period = timeout, max_age, period
        super().__init__()

    def make_server(self) -> ReferenceServer:
        timeout_ms, age_ms = int(LINK_TIMEOUT_MS * self._timeout), int(LINK_TIMEOUT_MS * self._max_age)
        server = ReferenceServer(77, self.arm_hash(), self.cycle_ns, timeout_ms, max_age_ms=age_ms)
        factory_period = self._period
        granted = server._granted

        def bent(*args: object) -> object:
            session = granted(*args)  # type: ignore[arg-type]
            period_ms = int(session.welcome.state_period_ms * factory_period)
            session.welcome = session.welcome._replace(state_period_ms=period_ms)
            return session

        server._granted = bent  # type: ignore[method-assign, assignment]
        self._asked: dict[int, int] = {}
        return server

    def outgoing(self, data: bytes) -> list[bytes]:
        def announced(welcome: Welcome) -> Welcome:
            period_ms = round(welcome.state_period_ms / self._period)
            return welcome._replace(link_timeout_ms=LINK_TIMEOUT_MS, state_period_ms=period_ms)

        return [reworked(data, Welcome, announced)]


class _Nonces(ControllerUnderTest):
    """Remembers another number of nonces."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.server._past_nonces = type(self.server._past_nonces)(maxlen=count)


UNSEEN = {
    "answers remembered: 257": "a longer memory answers alike",
    "answers remembered: 258": "a longer memory answers alike",
    "nonces remembered: 65": "a longer memory refuses no sound HELLO",
    "nonces remembered: 66": "a longer memory refuses no sound HELLO",
    "requests that wait: 65": "how many a scan judges, and so how many wait, is the controller's",
    "requests that wait: 66": "how many a scan judges, and so how many wait, is the controller's",
}


def _rows() -> Iterator[BrokenController]:
    def row(name: str, clause: str, make: object, key: LinkKey | None = None) -> BrokenController:
        return BrokenController(name, clause, make, key, unseen=UNSEEN.get(name, ""))  # type: ignore[arg-type]

    for limit in COUNTS:
        right = getattr(import_module(limit.module), limit.name)
        for off in (-2, -1, 1, 2):
            yield row(f"{limit.what}: {right + off}", limit.clause, partial(_Limited, limit, right + off))
    for off in (-2, -1, 1, 2):
        longest = partial(_Limited, COUNTS[0], 1440 + off, KEY)
        yield row(f"largest datagram, signed: {1440 + off}", "8", longest, KEY)
        yield row(f"late told from duplicate: {64 + off}", "8", _window(64 + off))
        yield row(f"nonces remembered: {64 + off}", "8", partial(_Nonces, 64 + off))
    for limit in TIMES:
        right = getattr(import_module(limit.module), limit.name)
        for factor in (0.5, 2):
            yield row(f"{limit.what} × {factor}", limit.clause, partial(_Limited, limit, int(right * factor)))
    for factor in (0.5, 2):
        yield row(f"link_timeout_ms × {factor}", "5.4", partial(_Timed, timeout=factor))
        yield row(f"state_period_ms × {factor}", "7.7", partial(_Timed, period=factor))
    # A shorter one is sound: max_age_ms is the controller's own, and not announced.
    yield row("max_age_ms × 2", "5.3", partial(_Timed, max_age=2))


MUTANTS = tuple(_rows())
