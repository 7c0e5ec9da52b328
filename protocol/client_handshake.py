"""The client's handshake: HELLO again and again under a nonce, and the session that an answer grants."""

from typing import NamedTuple

from protocol.authentication import ChannelKeys, LinkKey
from protocol.channel import Channel, LinkStatistics
from protocol.datagram import Header
from protocol.datagram_layout import VERSION_MINOR
from protocol.faults import Reason
from protocol.reference_messages import ANY_ARM, CAPABILITY_AUTHENTICATION, Hello, Welcome
from protocol.session_events import DatagramDropped

HELLO_PERIOD_NS = 100_000_000
HELLOS_PER_NONCE = 10


class Credentials(NamedTuple):
    """What a datagram of an open session carries, beside its numbers."""

    session: int
    minor: int
    client_nonce: int
    boot_id: int

    def channel(self, key: LinkKey | None, next_sequence: int) -> Channel:
        """One more channel of the client's in this session; ``key`` if it is an authenticated one."""
        keys = None if key is None else key.of_client(self.client_nonce, self.session, self.boot_id)
        return Channel(self.session, self.minor, next_sequence, keys)


class ClientHandshake:
    """Attempts to connect, each under another nonce. ``channel`` carries HELLO, signed if there is a key."""

    def __init__(
        self,
        nonce: int,
        arm_hash: int,
        state_period_ms: int,
        capabilities: int,
        first_sequence: int,
        key: LinkKey | None,
    ) -> None:
        self._nonce = nonce % 2**64 or 1
        self._arm_hash = arm_hash
        self._state_period_ms = state_period_ms
        self._capabilities = capabilities | (CAPABILITY_AUTHENTICATION if key else 0)
        self._key = key
        self._hellos_sent = 0
        self.due_ns = 0
        self.channel = self._channel(first_sequence)

    def begin(self, next_sequence: int) -> None:
        """Draws a new nonce and starts counting; numbers go on with ``next_sequence``."""
        self._nonce = (self._nonce + 1) % 2**64 or 1
        self._hellos_sent = 0
        self.channel = self._channel(next_sequence)

    def hello(self, now_ns: int) -> Hello:
        """The HELLO to say now; a new nonce after the tenth in vain."""
        # A session that the controller opened and gave up again unheard has used its nonce up.
        if self._hellos_sent == HELLOS_PER_NONCE:
            self.begin(self.channel.next_sequence)
        self._hellos_sent += 1
        self.due_ns = now_ns + HELLO_PERIOD_NS
        return Hello(self._nonce, self._capabilities, self._arm_hash, self._state_period_ms)

    def answered(
        self, header: Header, welcome: object, data: bytes, statistics: LinkStatistics
    ) -> Channel | Reason | DatagramDropped:
        """The session's channel; or why this one is not to be entered; or why it is no answer to HELLO."""
        if not isinstance(welcome, Welcome) or welcome.client_nonce != self._nonce:
            return statistics.drop("session.unknown", f"session {header.session:x} while connecting")
        granted = Credentials(header.session, header.minor, self._nonce, welcome.boot_id)
        channel = granted.channel(self._key, self.channel.next_sequence)
        forged = channel.unauthentic(data, header, statistics)
        if forged:
            return forged
        if header.minor > VERSION_MINOR:
            return Reason.INCOMPATIBLE_VERSION
        if self._arm_hash not in (ANY_ARM, welcome.arm_hash):
            return Reason.WRONG_ARM
        return channel

    def _channel(self, next_sequence: int) -> Channel:
        keys = ChannelKeys(self._key.of_hello(), self._key.of_hello()) if self._key else None
        return Channel(0, VERSION_MINOR, next_sequence, keys)
