"""Authentication of datagrams: the keys of a session and the tag behind every payload.

HMAC-SHA-256 (RFC 2104) cut to its first 16 bytes (RFC 4868, HMAC-SHA-256-128), keys derived with the counter
mode of NIST SP 800-108. Each session and each direction has a key of its own, so a datagram of another
session or a reflected one fails its tag; what comes again within a session is found by its 64-bit number
(``protocol.channel``).
"""

import hmac
from typing import NamedTuple

from protocol.datagram_layout import CRC_BYTES, CRC_OFFSET, FLAG_AUTHENTICATED, TAG_BYTES, TRAILER_BYTES

MIN_SECRET_BYTES = 32
_DIGEST = "sha256"
_DIGEST_BITS = 256
_KEY_ID_BYTES = 4
_AFTER_CRC = CRC_OFFSET + CRC_BYTES


class DirectionKey:
    """What the datagrams of one direction of one session are signed with; its repr does not show it."""

    __slots__ = ("_keyed", "key_id")

    def __init__(self, secret: bytes, key_id: int) -> None:
        # Half of a short datagram's HMAC is the key's: done once (RFC 2104, section 4).
        self._keyed = hmac.new(secret, digestmod=_DIGEST)
        self.key_id = key_id

    def tag(self, datagram: bytes) -> bytes:
        """The tag of a datagram that lacks nothing but its tag; the CRC's bytes do not count."""
        code = self._keyed.copy()
        code.update(datagram[:CRC_OFFSET])
        code.update(datagram[_AFTER_CRC:])
        return code.digest()[:TAG_BYTES]


class ChannelKeys(NamedTuple):
    """The keys of one end of a session."""

    sends: DirectionKey
    receives: DirectionKey


class LinkKey:
    """The secret that both ends share; its repr does not show it. Raises ValueError below 32 bytes."""

    def __init__(self, secret: bytes) -> None:
        if len(secret) < MIN_SECRET_BYTES:
            raise ValueError(f"a key of {len(secret)} bytes: at least {MIN_SECRET_BYTES} are wanted")
        self._secret = secret
        self.key_id = int.from_bytes(self._derived(b"LRLK 1 key id")[:_KEY_ID_BYTES], "little")
        self._hello = DirectionKey(self._derived(b"LRLK 1 hello"), self.key_id)

    def of_hello(self) -> DirectionKey:
        """What HELLO is signed with: there is no session yet to bind it to."""
        return self._hello

    def of_client(self, client_nonce: int, session: int, boot_id: int) -> ChannelKeys:
        """The client's keys of the session that HELLO and WELCOME agreed on."""
        controller, client = self._of_session(client_nonce, session, boot_id)
        return ChannelKeys(sends=client, receives=controller)

    def of_controller(self, client_nonce: int, session: int, boot_id: int) -> ChannelKeys:
        """The controller's keys of the same session."""
        controller, client = self._of_session(client_nonce, session, boot_id)
        return ChannelKeys(sends=controller, receives=client)

    def _of_session(self, *numbers: int) -> tuple[DirectionKey, DirectionKey]:
        context = b"".join(number.to_bytes(8, "little") for number in numbers)
        controller = self._derived(b"LRLK 1 controller", context)
        client = self._derived(b"LRLK 1 client", context)
        return DirectionKey(controller, self.key_id), DirectionKey(client, self.key_id)

    def _derived(self, label: bytes, context: bytes = b"") -> bytes:
        """SP 800-108r1, section 4.1, one block: [1] ‖ label ‖ 0 ‖ context ‖ [256], both counts big-endian."""
        one, length = (1).to_bytes(4, "big"), _DIGEST_BITS.to_bytes(4, "big")
        return hmac.digest(self._secret, one + label + b"\0" + context + length, _DIGEST)


def fault_of(datagram: bytes, flags: int, key: DirectionKey | None) -> str | None:
    """None if a decoded datagram carries what ``key`` (None: no key is configured) demands, else why not."""
    if not flags & FLAG_AUTHENTICATED:
        return None if key is None else "authentication.missing"
    if key is None:
        return "authentication.no_key"
    if datagram[-TRAILER_BYTES:][4:8] != key.key_id.to_bytes(_KEY_ID_BYTES, "little"):
        return "authentication.unknown_key"
    # In constant time, or the time of a refusal tells how much of a guessed tag is right.
    if not hmac.compare_digest(datagram[-TAG_BYTES:], key.tag(datagram[:-TAG_BYTES])):
        return "authentication.bad_tag"
    return None
