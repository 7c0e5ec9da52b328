"""Each limit of clause 8 off by one and by two, to both sides, and each time twice and half as long."""

from collections.abc import Iterator
from functools import partial

from protocol.reference_messages import Welcome
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutator import KEY, BrokenController, Make, edited, reworked

# What, in which module, as it stands there, its number, and the clause.
COUNTS = (
    ("largest datagram", "datagram", "size > MAX_DATAGRAM_BYTES", "size > {}", 1440, "8"),
    ("waypoints in a path", "datagram", "count > MAX_WAYPOINTS", "count > {}", 16, "3.6"),
    ("requests that wait", "inbox", "WAITING = 64", "WAITING = {}", 64, "6.14"),
    ("answers remembered", "ledger", "REMEMBERED = 256", "REMEMBERED = {}", 256, "8"),
    ("gap in the sequence", "channel", "MAX_GAP_DATAGRAMS = 1 << 16", "MAX_GAP_DATAGRAMS = {}", 65_536, "8"),
    ("late told from duplicate", "channel", "WINDOW_DATAGRAMS = 64", "WINDOW_DATAGRAMS = {}", 64, "8"),
    ("nonces remembered", "server", "REMEMBERED_NONCES = 64", "REMEMBERED_NONCES = {}", 64, "8"),
)
TIMES = (
    ("BYE to strangers", "server", "REFUSAL_INTERVAL_NS = 50", "REFUSAL_INTERVAL_NS = {}", 50, "8"),
    ("base of age", "channel", "BASE_WINDOW_NS = 10_000_000_000", "BASE_WINDOW_NS = {}", 10**10, "5.3"),
)
_LONGER_MEMORY = "a longer memory answers alike"
_LONGER_REFUSAL = "a longer memory refuses no sound HELLO"
_OWN = "how many a scan judges, and so how many wait, is the controller's"
UNSEEN = {
    "answers remembered: 257": _LONGER_MEMORY, "answers remembered: 258": _LONGER_MEMORY,
    "nonces remembered: 65": _LONGER_REFUSAL, "nonces remembered: 66": _LONGER_REFUSAL,
    "requests that wait: 65": _OWN, "requests that wait: 66": _OWN,
}  # fmt: skip


class _Timed(ControllerUnderTest):
    """Counts with another link timeout, greatest age or state period than it announces."""

    def __init__(self, timeout: float = 1.0, max_age: float = 1.0, period: float = 1.0) -> None:
        self._timeout, self._max_age, self._period = timeout, max_age, period
        super().__init__()

    def make_server(self) -> ReferenceServer:
        timeout_ms, age_ms = int(LINK_TIMEOUT_MS * self._timeout), int(LINK_TIMEOUT_MS * self._max_age)
        server = ReferenceServer(77, self.arm_hash(), self.cycle_ns, timeout_ms, max_age_ms=age_ms)
        granted = server._granted

        def bent(*args: object) -> object:
            session = granted(*args)
            period_ms = int(session.welcome.state_period_ms * self._period)
            session.welcome = session.welcome._replace(state_period_ms=period_ms)
            return session

        server._granted = bent
        return server

    def outgoing(self, data: bytes) -> list[bytes]:
        def announced(welcome: Welcome) -> Welcome:
            period_ms = round(welcome.state_period_ms / self._period)
            return welcome._replace(link_timeout_ms=LINK_TIMEOUT_MS, state_period_ms=period_ms)

        return [reworked(data, Welcome, announced)]


def _rows() -> Iterator[BrokenController]:
    def row(name: str, clause: str, make: Make) -> BrokenController:
        return BrokenController(name, clause, make, unseen=UNSEEN.get(name, ""))

    for what, module, old, new, right, clause in COUNTS:
        for value in (right - 2, right - 1, right + 1, right + 2):
            yield row(f"{what}: {value}", clause, edited((module, old, new.format(value))))
    _, module, old, new, right, _ = COUNTS[0]
    for value in (right - 2, right - 1, right + 1, right + 2):
        make = edited((module, old, new.format(value)), key=True)
        yield BrokenController(f"largest datagram, signed: {value}", "8", make, KEY)
    for what, module, old, new, right, clause in TIMES:
        for factor in (0.5, 2):
            yield row(f"{what} × {factor}", clause, edited((module, old, new.format(int(right * factor)))))
    for factor in (0.5, 2):
        yield row(f"link_timeout_ms × {factor}", "5.4", partial(_Timed, timeout=factor))
        yield row(f"state_period_ms × {factor}", "7.7", partial(_Timed, period=factor))
    # A shorter one is sound: max_age_ms is the controller's own, and not announced.
    yield row("max_age_ms × 2", "5.3", partial(_Timed, max_age=2))


MUTANTS = tuple(_rows())
