"""Datagrams that were read from a socket and are not yet judged: bounded, and no stop waits behind them.

Reading costs 2 µs a datagram, judging and answering 18. So all that has come is read every cycle, a slice
of it is judged, and who sends more than that fills this queue, not the one of the kernel, in which a stop
could not be found.
"""

import struct
from collections import deque

from protocol.datagram_layout import Kind
from protocol.reference_messages import STOPS

A_CYCLE = 32  # [D]
WAITING = 512  # [D]
Arrival = tuple[bytes, object]

_COMMAND = struct.Struct("<6xB9xQ16xQI")  # kind, session, id and code of a COMMAND, where they lie


class Arrivals:
    """Datagrams in order of arrival; a stop is always among the next ``A_CYCLE``.

    When a stop comes and that many wait before it, all are left out, as if the network had lost them, but of
    every kind of stop the one with the highest id: the others are at most repetitions.
    """

    def __init__(self) -> None:
        self._waiting: deque[Arrival] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, data: bytes, source: object, session: int | None) -> int:
        """How many datagrams are left out for want of room; stops of ``session``, the open one, are not."""
        stop = stop_of(data, session)
        if stop is None and len(self._waiting) >= WAITING:
            return 1
        self._waiting.append((data, source))
        return 0 if stop is None or len(self._waiting) <= A_CYCLE else self._clear_the_way(session)

    def take(self, most: int) -> list[Arrival]:
        """The oldest, at most so many."""
        return [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]

    def _clear_the_way(self, session: int | None) -> int:
        highest: dict[int, tuple[int, Arrival]] = {}
        for arrival in self._waiting:
            stop = stop_of(arrival[0], session)
            if stop is None:
                continue
            code, command_id = stop
            if code not in highest or command_id >= highest[code][0]:
                highest.pop(code, None)  # to its place in the order of arrival
                highest[code] = command_id, arrival
        left_out = len(self._waiting) - len(highest)
        self._waiting = deque(arrival for _, arrival in highest.values())
        return left_out


def stop_of(data: bytes, session: int | None) -> tuple[int, int] | None:
    """Code and id of a datagram that says it is a stop of ``session``; whether it is, the session judges."""
    if session is None or len(data) < _COMMAND.size:
        return None
    kind, of_session, command_id, code = _COMMAND.unpack_from(data)
    return (code, command_id) if kind == Kind.COMMAND and of_session == session and code in STOPS else None
