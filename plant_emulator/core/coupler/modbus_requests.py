"""Modbus requests as the coupler judges them: function codes, exceptions, and which addresses each reaches.

Modbus application protocol V1.1b3, section 6.
"""

from collections.abc import Sequence
from typing import NamedTuple


class Turns:
    """Turns at least ``turn_ns`` apart, and further apart the longer they take.

    What a turn cost, and what was spent on the others since the one before, is at most ``share`` of the time
    until the next one begins, however slow the machine is.
    """

    def __init__(self, turn_ns: int, share: float) -> None:
        self.next_ns = 0
        self._turn_ns = turn_ns
        self._share = share
        self._beside_ns = 0

    def spent(self, cost_ns: int) -> None:
        """Note time spent on the others outside a turn."""
        self._beside_ns += cost_ns

    def took(self, began_ns: int, ended_ns: int) -> None:
        """Note a turn: ``next_ns`` is the earliest beginning of the one after."""
        cost_ns = ended_ns - began_ns + self._beside_ns
        self._beside_ns = 0
        self.next_ns = began_ns + max(self._turn_ns, int(cost_ns / self._share))


ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
WATCHDOG_EXPIRED = 4
OWNED_BY_ANOTHER = 6

READ_COILS = 1
READ_DISCRETE = 2
READ_HOLDING = 3
READ_INPUT = 4
WRITE_COIL = 5
WRITE_SINGLE = 6
DIAGNOSTICS = 8
WRITE_COILS = 15
WRITE_MULTIPLE = 16
READ_WRITE_MULTIPLE = 23

# Sub-functions of DIAGNOSTICS (section 6.8); all but the echo take one word that must be zero.
ECHO = 0
READ_STATUS = 2
CLEAR_COUNTERS = 10
COUNT_MESSAGES = 11
COUNT_FRAMING_ERRORS = 12
COUNT_EXCEPTIONS = 13
COUNT_ADDRESSED = 14
SUB_FUNCTIONS = (
    ECHO,
    READ_STATUS,
    CLEAR_COUNTERS,
    COUNT_MESSAGES,
    COUNT_FRAMING_ERRORS,
    COUNT_EXCEPTIONS,
    COUNT_ADDRESSED,
)


class Span(NamedTuple):
    """Registers or bits from ``address`` on."""

    address: int
    words: int


class Request(NamedTuple):
    """What a master asks: registers or bits to read, others to write, and the ``values`` that they get.

    ``code``: the exception that its form deserves, or 0. Function code 8 has its sub-function and its data
    as values.
    """

    function: int
    code: int = 0
    reads: Span | None = None
    writes: Span | None = None
    values: Sequence[int] = ()


class RegisterMap(NamedTuple):
    """What each function code may reach; a request must lie within one span.

    ``reads`` holds the function codes 1 to 4 and 23, ``writes`` 5, 6, 15, 16 and 23.
    """

    reads: dict[int, tuple[Span, ...]]
    writes: dict[int, tuple[Span, ...]]

    def exception_for(self, request: Request) -> int:
        """The exception code that form and addresses of a request deserve; 0 when they are sound."""
        function, code, reads, writes, _ = request
        if code == 0 and writes is not None:
            code = _within(writes, self.writes[function])
        return _within(reads, self.reads[function]) if code == 0 and reads is not None else code


def _within(span: Span, allowed: tuple[Span, ...]) -> int:
    for whole in allowed:
        if whole.address <= span.address and span.address + span.words <= whole.address + whole.words:
            return 0
    return ILLEGAL_ADDRESS
