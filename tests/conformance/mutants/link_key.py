"""Controllers wrong in what a key protects: window, key id, order, trailer; each with its case."""

import struct
from typing import Any

from conformance.bytes_of import with_number
from protocol import channel
from protocol.authentication import fault_of
from protocol.datagram import Datagram, Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES, TAG_BYTES, TRAILER_BYTES, Kind
from protocol.errors import DatagramRefused
from protocol.faults import Reason
from protocol.reference_messages import Bye
from protocol.server_session import ReferenceServer
from protocol.session_events import ServerEvent
from tests.conformance.mutants.breaking import Mutant
from tests.conformance.mutants.key import KEY, KeyedController
from tests.conformance.mutants.link import ShortWindow

_LOW = 0xFFFFFFFF


class KeyedWithHalfTheWindow(KeyedController):
    """Has a replay window of 32 numbers."""

    def make_server(self) -> ReferenceServer:
        server = super().make_server()
        granted = server._granted

        def bent(header: Header, *args: Any) -> Any:
            session = granted(header, *args)
            session.channel._window = ShortWindow(header.sequence, channel.EXTENDED_MODULUS)
            return session

        server._granted = bent  # type: ignore[method-assign]
        return server


class IgnoresTheKeyId(KeyedController):
    """Looks at the tag alone."""

    def incoming(self, data: bytes) -> bytes | None:
        key = self.expected(data) if len(data) >= HEADER_BYTES + TRAILER_BYTES else None
        if key is None or not data[9] & 1 or key.tag(data[:-TAG_BYTES]) != data[-TAG_BYTES:]:
            return data
        return self.signed(data)


class _OccupiedFirst(ReferenceServer):
    def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
        occupied = self._session and self._session.source != source
        if occupied and len(data) >= 72 and data[6] == Kind.HELLO:
            self._refuse(Reason.SESSION_OCCUPIED, 0, source, now_ns)
            return []
        return super().receive(data, source, now_ns)


class LooksAtTheKeyLast(KeyedController):
    """Tells a second client that it is occupied, whether it has the key or not."""

    server_class = _OccupiedFirst


class ForgeriesMoveTheAge(KeyedController):
    """Lets a forged datagram set the least transit."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def _in_session(self, datagram: Datagram, *args: Any) -> list[ServerEvent]:
                if self._session and datagram.header.session == self._session.channel.session:
                    self._session.channel._age.age_ns(datagram.header.sent_ns, args[2])
                return super()._in_session(datagram, *args)

        return self.server_of(Server)


class CountsFromTheFirstHeartbeat(KeyedController):
    """Begins to count with the datagram that begins the session."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def _granted(self, *args: Any) -> Any:
                session = super()._granted(*args)
                session.channel._window = None
                return session

        return self.server_of(Server)


class ComparesHalfTheNumber(KeyedController):
    """Puts the upper half of the newest number in the place of the one that came."""

    def incoming(self, data: bytes) -> bytes | None:
        session, key = self.server._session, self.expected(data) if len(data) >= 64 else None
        if session is None or key is None or data[6] == Kind.HELLO or fault_of(data, 0x100, key):
            return data
        window = session.channel._window
        header, message = decode(data)
        high = window.newest >> 32 << 32 if window else 0
        return encode(message, header._replace(sequence=high + (header.sequence & _LOW)), key)


class CountsTheTrailer(KeyedController):
    """Takes a length that counts the trailer as well."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < 64 or struct.unpack_from("<H", data, 10)[0] != len(data) - HEADER_BYTES:
            return data
        return self.signed(with_number(data, 10, "H", len(data) - HEADER_BYTES - TRAILER_BYTES))


class SignsItsHints(KeyedController):
    """Signs BYE to those without a session, with the key that HELLO is signed with."""

    def outgoing(self, data: bytes) -> list[bytes]:
        try:
            header, message = decode(data)
        except DatagramRefused:
            return [data]
        hint = isinstance(message, Bye) and not header.flags & 0x100
        return [encode(message, header, KEY.of_hello()) if hint else data]


LINK_KEY_MUTANTS = (
    Mutant(KeyedWithHalfTheWindow, 723),
    Mutant(IgnoresTheKeyId, 724),
    Mutant(LooksAtTheKeyLast, 725),
    Mutant(ForgeriesMoveTheAge, 726),
    Mutant(CountsFromTheFirstHeartbeat, 727),
    Mutant(ComparesHalfTheNumber, 728),
    Mutant(CountsTheTrailer, 729),
    Mutant(SignsItsHints, 730),
)
