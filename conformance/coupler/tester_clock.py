"""The tester's clock: what was asked when, and whether the coupler did something in its time.

An answer tells of a moment between its request and itself, so a time is bounded from both sides without
leave for the tester's own lateness.
"""

import time
from typing import NamedTuple

from conformance.master import Master
from conformance.wire import require

# Slack of the cases that time the coupler: how late it may be, and how much its clock's steps may be.
LATE_MS = 50.0
STEP_MS = 5.0
LOOK_EACH_MS = 5.0
_LOOK_BEFORE_MS = 30.0


class Moment(NamedTuple):
    """When the coupler did something: between these two times of the tester, ms."""

    earliest_ms: float
    latest_ms: float


def now_ms() -> float:
    """The tester's time, ms."""
    return time.monotonic() * 1e3


def wait(ms: float) -> None:
    """Lets time pass."""
    time.sleep(max(ms, 0.0) / 1e3)


def timed(master: Master, pdu: bytes, what: str) -> Moment:
    """When the coupler carried out ``pdu``; raises Failed when it refused."""
    before = now_ms()
    master.done(pdu, what)
    return Moment(before, now_ms())


def wait_until(ms: float) -> None:
    """Lets time pass until the tester's clock shows ``ms``."""
    wait(ms - now_ms())


def require_expiry(observer: Master, fed: Moment, time_ms: float, why: str) -> None:
    """Raises Failed unless the watchdog expires ``time_ms`` after it was fed.

    Slack: not more than STEP_MS early, not more than LATE_MS late.
    """
    wait_until(fed.latest_ms + time_ms - _LOOK_BEFORE_MS)
    while True:
        asked_ms = now_ms()
        expired = observer.expired
        if expired:
            early_ms = fed.earliest_ms + time_ms - now_ms()
            require(
                early_ms <= STEP_MS, f"{why}: expired at least {early_ms:.0f} ms before its {time_ms:g} ms"
            )
            return
        late_ms = asked_ms - fed.latest_ms - time_ms
        require(late_ms <= LATE_MS, f"{why}: not expired {late_ms:.0f} ms after its {time_ms:g} ms")
        wait(LOOK_EACH_MS)


def require_alive(observer: Master, fed: Moment, time_ms: float, why: str) -> None:
    """Raises Failed when the watchdog has expired although ``time_ms`` since ``fed`` have not passed."""
    expired = observer.expired
    early_ms = fed.earliest_ms + time_ms - now_ms()
    require(not expired or early_ms <= STEP_MS, f"{why}: expired at least {early_ms:.0f} ms too soon")
