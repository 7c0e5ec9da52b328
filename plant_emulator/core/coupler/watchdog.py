"""The coupler's watchdog and the ownership of its outputs, as one state; docs/process_image.md, 4 and 5."""

from plant_emulator.core.coupler.modbus_requests import ILLEGAL_VALUE, OWNED_BY_ANOTHER, WATCHDOG_EXPIRED
from protocol.coupler_registers import (
    RESET_WORDS,
    TRIGGER_ANY,
    TRIGGER_WRITES,
    WATCHDOG_DEFAULT_MS,
    WATCHDOG_RESET,
    WATCHDOG_TIME_MS,
)

MS = 1_000_000


class CouplerWatchdog:
    """Who may write, and whether that master is still there.

    The first write to the outputs arms the watchdog and makes the writer their owner; the owner's telegrams
    retrigger it. Expiry latches until the two reset words. ``release_ns``: an owner that has not written for
    so long may be followed by another master, which matters where the watchdog is off or slower than that.
    A master is any object that stands for its connection; all times are of one monotonic clock.
    """

    def __init__(self, release_ns: int) -> None:
        self.time_ms = WATCHDOG_DEFAULT_MS
        self.trigger = TRIGGER_ANY
        self.expired = False
        self.armed = False
        self.reset_word = 0
        self._release_ns = release_ns
        self._owner: object | None = None
        self._written_ns = 0
        self._fed_ns = 0
        self._resetting: object | None = None

    def expires_at_ns(self) -> int:
        """When it expires unless the owner speaks; meaningful while it is armed."""
        return self._fed_ns + self.time_ms * MS

    def left_ms(self, now_ns: int) -> int:
        """Milliseconds until it expires, rounded up; 0 while it is inactive or expired."""
        return -((now_ns - self.expires_at_ns()) // MS) if self.armed else 0

    def look(self, now_ns: int) -> bool:
        """Whether it expires at this moment; true once, then ``expired`` stays until it is reset."""
        if not self.armed or now_ns < self.expires_at_ns():
            return False
        self.armed, self.expired, self._owner = False, True, None
        return True

    def refusal(self, master: object, writes: bool, now_ns: int) -> int:
        """The exception that a sound access to the process image deserves, or 0."""
        if self.expired:
            return WATCHDOG_EXPIRED
        return OWNED_BY_ANOTHER if writes and self.is_owned_by_another(master, now_ns) else 0

    def is_owned_by_another(self, master: object, now_ns: int) -> bool:
        """Whether another master owns the outputs now."""
        if self._owner is None or self._owner is master:
            return False
        return now_ns - self._written_ns < self._release_ns

    def obeyed(self, master: object, wrote: bool, now_ns: int) -> None:
        """Takes note of a telegram that was carried out; ``wrote`` outputs makes its sender the owner."""
        if wrote:
            self._owner, self._written_ns, self._fed_ns = master, now_ns, now_ns
            self.armed = self.time_ms > 0
        elif master is self._owner and self.trigger == TRIGGER_ANY:
            self._fed_ns = now_ns

    def gone(self, master: object) -> None:
        """A connection has closed: others may write, but an armed watchdog runs on."""
        if self._owner is master:
            self._owner = None
        if self._resetting is master:
            self._resetting = None

    def configure(self, master: object, address: int, word: int, now_ns: int) -> int:
        """Writes one of the three watchdog registers; the exception that it deserves, or 0."""
        if self.is_owned_by_another(master, now_ns):
            return OWNED_BY_ANOTHER
        if address == WATCHDOG_RESET:
            return self._reset(master, word)
        if address == WATCHDOG_TIME_MS:
            if self.armed or self.expired:
                return WATCHDOG_EXPIRED
            self.time_ms = word
            return 0
        if word not in (TRIGGER_WRITES, TRIGGER_ANY):
            return ILLEGAL_VALUE
        self.trigger = word
        return 0

    def _reset(self, master: object, word: int) -> int:
        first, second = RESET_WORDS
        half_done, self._resetting = self._resetting is master, None
        if word == first:
            self._resetting = master
        elif word != second or not half_done:
            return ILLEGAL_VALUE
        else:
            self.armed, self.expired, self._owner = False, False, None
        self.reset_word = word
        return 0
