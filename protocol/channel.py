"""What both ends of a session share: numbering of datagrams, and their order and age on arrival."""

from dataclasses import dataclass
from enum import Enum

from protocol.datagram import Header, encode
from protocol.datagram_layout import FLAG_ECHO_VALID
from protocol.reference_messages import Message
from protocol.session_events import DatagramDropped

SEQUENCE_MODULUS = 1 << 32
WINDOW_DATAGRAMS = 64
MAX_GAP_DATAGRAMS = 1 << 16
BASE_WINDOW_NS = 10_000_000_000
_NS_PER_MS = 1_000_000
_ALL_SEEN = (1 << WINDOW_DATAGRAMS) - 1


@dataclass(slots=True)
class LinkStatistics:
    """Datagrams counted since the endpoint was made.

    ``received``: intact, in order, fresh, and used. ``lost``: skipped numbers that have not come.
    ``reordered``: came after a newer one. ``foreign``: of another session, source or direction.
    ``longest_gap``: most lost in a row.
    """

    received: int = 0
    lost: int = 0
    longest_gap: int = 0
    duplicated: int = 0
    reordered: int = 0
    stale: int = 0
    refused: int = 0
    foreign: int = 0

    @property
    def dropped(self) -> int:
        """Datagrams that came and were not used."""
        return self.duplicated + self.reordered + self.stale + self.refused + self.foreign


class Arrival(Enum):
    """How a sequence number relates to those before it; the value is the cause of a drop."""

    NEW = "sequence.new"
    DUPLICATE = "sequence.duplicate"
    LATE = "sequence.reordered"
    OLD = "sequence.old"
    JUMP = "sequence.jump"


class SequenceWindow:
    """Order of arrival modulo 2^32; a memory of the newest 64 numbers tells a duplicate from a late one."""

    def __init__(self, newest: int) -> None:
        self.newest = newest
        # What was sent before the session began is not missing from it.
        self._seen = _ALL_SEEN

    def arrive(self, sequence: int) -> tuple[Arrival, int]:
        """What ``sequence`` is, and how many numbers it skipped. Only a NEW one moves the window."""
        ahead = (sequence - self.newest) % SEQUENCE_MODULUS
        if ahead < SEQUENCE_MODULUS // 2:
            if ahead == 0:
                return Arrival.DUPLICATE, 0
            if ahead > MAX_GAP_DATAGRAMS:
                return Arrival.JUMP, 0
            self._seen = (self._seen << min(ahead, WINDOW_DATAGRAMS) | 1) & _ALL_SEEN
            self.newest = sequence
            return Arrival.NEW, ahead - 1
        behind = SEQUENCE_MODULUS - ahead
        if behind >= WINDOW_DATAGRAMS:
            return Arrival.OLD, 0
        if self._seen >> behind & 1:
            return Arrival.DUPLICATE, 0
        self._seen |= 1 << behind
        return Arrival.LATE, 0


class TransitAge:
    """How much longer a datagram was under way than the fastest of the last 10 to 20 s.

    Needs no common clock: only differences of (local time of receipt − sender's time of sending) count, so
    the sender's clock may be wrong by hours. A backlog that waited in a socket shows as age although it comes
    in order.
    """

    def __init__(self) -> None:
        self._current: int | None = None
        self._previous: int | None = None
        self._rotate_ns = 0

    def age_ns(self, sent_ns: int, now_ns: int) -> int:
        """Age of a datagram that is read at ``now_ns``, at least 0; the fastest of all times has age 0."""
        transit = now_ns - sent_ns
        if self._current is None or now_ns >= self._rotate_ns:
            self._previous, self._current = self._current, transit
            self._rotate_ns = now_ns + BASE_WINDOW_NS
        self._current = min(self._current, transit)
        base = self._current if self._previous is None else min(self._current, self._previous)
        return transit - base


class Channel:
    """One direction out, one direction in, of one session."""

    def __init__(self, session: int, minor: int, next_sequence: int) -> None:
        self.session = session
        self.minor = minor
        self.next_sequence = next_sequence
        self.heard_ns: int | None = None
        self.age_ns = 0
        self._window: SequenceWindow | None = None
        self._age = TransitAge()

    def sealed(self, message: Message, now_ns: int) -> bytes:
        """The datagram that carries ``message`` next on this channel."""
        flags, echo = (FLAG_ECHO_VALID, self._window.newest) if self._window else (0, 0)
        header = Header(self.session, self.next_sequence, now_ns, echo, flags, self.minor)
        datagram = encode(message, header)
        self.next_sequence = (self.next_sequence + 1) % SEQUENCE_MODULUS
        return datagram

    def hear(
        self, header: Header, now_ns: int, max_age_ns: int | None, tally: LinkStatistics
    ) -> DatagramDropped | None:
        """None if the datagram is to be used, else why not; the first one to come sets the start.

        ``max_age_ns`` None: of any age. ``age_ns`` becomes its age; ``heard_ns`` the time at which the newest
        one left the peer, as far as the least transit tells.
        """
        if self._window is None:
            self._window = SequenceWindow(header.sequence)
        else:
            arrival, skipped = self._window.arrive(header.sequence)
            if arrival is not Arrival.NEW:
                tally.duplicated += arrival is Arrival.DUPLICATE
                tally.reordered += arrival is not Arrival.DUPLICATE
                tally.lost -= arrival is Arrival.LATE
                why = f"sequence {header.sequence} after {self._window.newest}"
                return DatagramDropped(arrival.value, why)
            tally.lost += skipped
            tally.longest_gap = max(tally.longest_gap, skipped)
        age_ns = self._age.age_ns(header.sent_ns, now_ns)
        self.age_ns = age_ns
        left_ns = now_ns - age_ns
        self.heard_ns = left_ns if self.heard_ns is None else max(self.heard_ns, left_ns)
        if max_age_ns is not None and age_ns > max_age_ns:
            tally.stale += 1
            return DatagramDropped("datagram.stale", f"{age_ns // _NS_PER_MS} ms old when it was read")
        tally.received += 1
        return None
