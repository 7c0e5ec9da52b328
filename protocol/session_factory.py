"""What a controller grants: a session with its number, keys and welcome."""

import hashlib
from dataclasses import dataclass, field

from protocol.authentication import LinkKey
from protocol.channel import Channel, LinkStatistics
from protocol.command_ledger import CommandLedger
from protocol.datagram import Header
from protocol.datagram_layout import VERSION_MINOR
from protocol.reference_messages import CAPABILITY_AUTHENTICATION, Hello, Welcome

Source = object


@dataclass(slots=True)
class LinkSession:
    """One granted session; ``greeted_ns``, ``next_state_ns``: times of the controller's clock."""

    channel: Channel
    source: Source
    welcome: Welcome
    hello_sent_ns: int
    greeted_ns: int
    next_state_ns: int
    ledger: CommandLedger = field(default_factory=CommandLedger)

    def is_of(self, hello: Hello, source: Source) -> bool:
        """Whether this is the session that ``hello`` asked for before."""
        return source == self.source and hello.client_nonce == self.welcome.client_nonce


class SessionFactory:
    """Makes the sessions of one controller, from its start on; parameters as those of ReferenceServer."""

    def __init__(
        self,
        boot_id: int,
        arm_hash: int,
        cycle_ns: int,
        link_timeout_ms: int,
        capabilities: int,
        first_sequence: int,
        key: LinkKey | None,
    ) -> None:
        self.count = 0
        self._secret, self._boot_id = divmod(boot_id, 2**64)
        self._arm_hash = arm_hash
        self._cycle_ns = cycle_ns
        self._link_timeout_ms = link_timeout_ms
        self._capabilities = capabilities & ~CAPABILITY_AUTHENTICATION
        self._capabilities |= CAPABILITY_AUTHENTICATION if key else 0
        self._first_sequence = first_sequence
        self._key = key

    def grant(
        self, header: Header, hello: Hello, source: Source, now_ns: int, statistics: LinkStatistics
    ) -> LinkSession:
        """The session that ``hello`` opens; its sequence numbers begin with HELLO's."""
        self.count += 1
        number = _session_number(self._secret, self._boot_id, hello.client_nonce, self.count)
        keys = self._key.of_controller(hello.client_nonce, number, self._boot_id) if self._key else None
        channel = Channel(number, min(header.minor, VERSION_MINOR), self._first_sequence, keys)
        channel.hear(header, now_ns, None, statistics)
        welcome = Welcome(
            hello.client_nonce,
            hello.capabilities & self._capabilities,
            self._arm_hash,
            self._boot_id,
            self._cycle_ns,
            self._link_timeout_ms,
            hello.state_period_ms,
        )
        return LinkSession(channel, source, welcome, header.sent_ns, now_ns, now_ns)


def _session_number(secret: int, *public: int) -> int:
    """A number that no other session of this or another controller has, and that is never 0.

    Who knows the ``public`` numbers cannot tell it without the ``secret``.
    """
    seed = b"".join(number.to_bytes(8, "little") for number in public)
    seed += secret.to_bytes((secret.bit_length() + 7) // 8, "little")
    return int.from_bytes(hashlib.sha256(seed).digest()[:8], "little") or 1
