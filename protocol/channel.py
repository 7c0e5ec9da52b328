"""What both ends of a session share: numbering of datagrams, and their order and age on arrival."""

from dataclasses import dataclass
from enum import Enum

from protocol.authentication import ChannelKeys, DirectionKey, fault_of
from protocol.datagram import Header, encode
from protocol.datagram_layout import FLAG_ECHO_VALID
from protocol.reference_messages import Message
from protocol.session_events import DatagramDropped

SEQUENCE_MODULUS = 1 << 32
EXTENDED_MODULUS = 1 << 64
WINDOW_DATAGRAMS = 64
MAX_GAP_DATAGRAMS = 1 << 16
BASE_WINDOW_NS = 10_000_000_000
_NS_PER_MS = 1_000_000
_ALL_SEEN = (1 << WINDOW_DATAGRAMS) - 1


@dataclass(slots=True)
class LinkStatistics:
    """Datagrams counted since the endpoint was made.

    ``received``: intact, in order, fresh, and used. ``lost``: skipped numbers that have not come.
    ``longest_gap``: most lost in a row. The others came and were not used: ``duplicated``, ``reordered``
    (after a newer one), ``stale`` (older than allowed), ``refused`` (not a datagram), ``foreign`` (of another
    session, source or direction). For the sake of authentication: ``not_authenticated`` (without a tag),
    ``key_not_configured`` (with a tag, and no key is configured here), ``unknown_key``, ``bad_tag``,
    ``replayed`` (came before), ``too_old`` (behind the replay window). ``echoes_refused``: answers to
    heartbeats, received in order, that the clock's offset was not estimated from.
    """

    received: int = 0
    lost: int = 0
    longest_gap: int = 0
    duplicated: int = 0
    reordered: int = 0
    stale: int = 0
    refused: int = 0
    foreign: int = 0
    not_authenticated: int = 0
    key_not_configured: int = 0
    unknown_key: int = 0
    bad_tag: int = 0
    replayed: int = 0
    too_old: int = 0
    echoes_refused: int = 0

    @property
    def dropped(self) -> int:
        """Datagrams that came and were not used."""
        return (
            self.duplicated + self.reordered + self.stale + self.refused + self.foreign
            + self.not_authenticated + self.key_not_configured + self.unknown_key + self.bad_tag
            + self.replayed + self.too_old
        )  # fmt: skip

    def drop(self, cause: str, detail: str) -> DatagramDropped:
        """The event of a datagram that was not used for ``cause``, once it is counted."""
        counter = _COUNTERS.get(cause) or _COUNTERS[cause.partition(".")[0]]
        setattr(self, counter, getattr(self, counter) + 1)
        return DatagramDropped(cause, detail)


# The counter of each cause, or of all causes of a family.
_COUNTERS = {
    "authentication.missing": "not_authenticated",
    "authentication.no_key": "key_not_configured",
    "authentication.unknown_key": "unknown_key",
    "authentication.bad_tag": "bad_tag",
    "authentication.replayed": "replayed",
    "authentication.too_old": "too_old",
    "sequence.duplicate": "duplicated",
    "sequence": "reordered",
    "datagram.stale": "stale",
    "datagram": "refused",
    "session": "foreign",
}


def is_newer(number: int, other: int) -> bool:
    """Whether a serial number modulo 2^32 is newer than another one."""
    return 0 < (number - other) % SEQUENCE_MODULUS < SEQUENCE_MODULUS // 2


class Arrival(Enum):
    """How a sequence number relates to those before it; the value is the cause of a drop."""

    NEW = "sequence.new"
    DUPLICATE = "sequence.duplicate"
    LATE = "sequence.reordered"
    OLD = "sequence.old"
    JUMP = "sequence.jump"


# What the same arrivals are where every number is known to be the peer's own.
_AUTHENTICATED_CAUSES = {
    Arrival.DUPLICATE: "authentication.replayed",
    Arrival.OLD: "authentication.too_old",
}


class SequenceWindow:
    """Order of arrival; a memory of the newest 64 numbers tells a duplicate from a late one.

    Numbers count modulo 2^32, or modulo 2^64 in an authenticated session: there none ever comes again, and
    the window is the replay window of RFC 4303 section 3.4.3 (and of RFC 6479, whose ring of words Python's
    integers make superfluous).
    """

    def __init__(self, newest: int, modulus: int = SEQUENCE_MODULUS) -> None:
        self.newest = newest
        self._modulus = modulus
        # What was sent before the session began is not missing from it.
        self._seen = _ALL_SEEN

    def arrive(self, sequence: int) -> tuple[Arrival, int]:
        """What ``sequence`` is, and how many numbers it skipped. Only a NEW one moves the window."""
        ahead = (sequence - self.newest) % self._modulus
        if ahead < self._modulus // 2:
            if ahead == 0:
                return Arrival.DUPLICATE, 0
            if ahead > MAX_GAP_DATAGRAMS:
                return Arrival.JUMP, 0
            self._seen = (self._seen << min(ahead, WINDOW_DATAGRAMS) | 1) & _ALL_SEEN
            self.newest = sequence
            return Arrival.NEW, ahead - 1
        behind = self._modulus - ahead
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
    """One direction out, one direction in, of one session; ``keys`` if it is an authenticated one."""

    def __init__(self, session: int, minor: int, next_sequence: int, keys: ChannelKeys | None = None) -> None:
        self.session = session
        self.minor = minor
        self.next_sequence = next_sequence
        self.keys = keys
        self._modulus = SEQUENCE_MODULUS if keys is None else EXTENDED_MODULUS
        self.heard_ns: int | None = None
        self.age_ns = 0
        self._window: SequenceWindow | None = None
        self._age = TransitAge()

    def encoded(self, message: Message, now_ns: int) -> bytes:
        """The datagram that carries ``message`` next on this channel."""
        flags, echo = (FLAG_ECHO_VALID, self._window.newest % SEQUENCE_MODULUS) if self._window else (0, 0)
        number = self.next_sequence % self._modulus
        header = Header(self.session, number, now_ns, echo, flags, self.minor)
        self.next_sequence = number + 1
        return encode(message, header, self.keys.sends if self.keys else None)

    def unauthentic(self, data: bytes, header: Header, statistics: LinkStatistics) -> DatagramDropped | None:
        """None if a datagram of this session carries the tag that it must, else why not; it is counted."""
        return unauthentic(data, header, self.keys.receives if self.keys else None, statistics)

    def hear(
        self, header: Header, now_ns: int, max_age_ns: int | None, statistics: LinkStatistics
    ) -> DatagramDropped | None:
        """None if the datagram is to be used, else why not; the first one to come sets the start.

        ``max_age_ns`` None: of any age. ``age_ns`` becomes its age; ``heard_ns`` the time at which the newest
        one that is not too old left the peer, as far as the least transit tells.
        """
        if self._window is None:
            self._window = SequenceWindow(header.sequence, self._modulus)
        else:
            arrival, skipped = self._window.arrive(header.sequence)
            if arrival is not Arrival.NEW:
                statistics.lost -= arrival is Arrival.LATE
                cause = _AUTHENTICATED_CAUSES.get(arrival) if self.keys else None
                return statistics.drop(
                    cause or arrival.value, f"sequence {header.sequence} after {self._window.newest}"
                )
            statistics.lost += skipped
            statistics.longest_gap = max(statistics.longest_gap, skipped)
        age_ns = self._age.age_ns(header.sent_ns, now_ns)
        self.age_ns = age_ns
        if max_age_ns is not None and age_ns > max_age_ns:
            return statistics.drop("datagram.stale", f"{age_ns // _NS_PER_MS} ms old when it was read")
        left_ns = now_ns - age_ns
        self.heard_ns = left_ns if self.heard_ns is None else max(self.heard_ns, left_ns)
        statistics.received += 1
        return None


def unauthentic(
    data: bytes, header: Header, key: DirectionKey | None, statistics: LinkStatistics
) -> DatagramDropped | None:
    """None if ``data`` carries the tag that ``key`` demands (None: no tag), else the refusal, counted."""
    cause = fault_of(data, header.flags, key)
    return None if cause is None else statistics.drop(cause, f"sequence {header.sequence}")
