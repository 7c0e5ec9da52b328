"""Datagrams that were read from a socket and are not yet judged: bounded, and no stop waits behind them.

Reading costs a microsecond a datagram, judging fifty. So all that has come is read every cycle, a slice of it
is judged, and who sends more than that fills this queue, not the one of the kernel, in which a stop could
not be found.
"""

import struct
from collections import deque

from protocol.datagram_layout import Kind
from protocol.reference_messages import STOPS

A_CYCLE = 32
WAITING = 512
Arrival = tuple[bytes, object]

_COMMAND = struct.Struct("<6xB9xQ24xI")  # kind, session and the code of a COMMAND, where they lie


class Arrivals:
    """Datagrams in order of arrival; a stop is always among the next ``A_CYCLE``.

    When a stop comes and that many wait before it, they are left out but for the newest stop of each other
    code: as if the network had lost them.
    """

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, data: bytes, source: object, session: int | None) -> int:
        """How many datagrams are left out for want of room; stops of ``session``, the open one, are not."""
        code = stop_code_of(data, session)
        if code is None and len(self._waiting) >= WAITING:
            return 1
        left_out = 0
        if code is not None and len(self._waiting) >= A_CYCLE:
            left_out = self._clear_the_way(code, session)
        self._waiting.append((data, source))
        return left_out

    def take(self, most: int) -> list[Arrival]:
        """The oldest, at most so many."""
        return [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]

    def _clear_the_way(self, code: int, session: int | None) -> int:
        newest: dict[int, Arrival] = {}
        for arrival in self._waiting:
            other = stop_code_of(arrival[0], session)
            if other is not None and other != code:
                newest.pop(other, None)  # to its place in the order of arrival
                newest[other] = arrival
        left_out = len(self._waiting) - len(newest)
        self._waiting = deque(newest.values())
        return left_out


def stop_code_of(data: bytes, session: int | None) -> int | None:
    """The code of a datagram that says it is a stop of ``session``; whether it is, the session judges."""
    if session is None or len(data) < _COMMAND.size:
        return None
    kind, of_session, code = _COMMAND.unpack_from(data)
    return code if kind == Kind.COMMAND and of_session == session and code in STOPS else None
