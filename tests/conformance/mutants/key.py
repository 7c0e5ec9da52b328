"""Controllers with a key and one thing wrong with it each, and the cases meant to catch them."""

from conformance.bytes_of import resealed, with_bit_flipped
from protocol import channel
from protocol.authentication import DirectionKey, LinkKey, fault_of
from protocol.channel import LinkStatistics
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES, TAG_BYTES, TRAILER_BYTES, Kind
from protocol.errors import DatagramRefused
from protocol.reference_messages import State
from protocol.server_session import ReferenceServer
from protocol.session_events import DatagramDropped, ServerEvent
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import Mutant, with_window
from tests.conformance.mutants.datagram import NoDuplicates

KEY = LinkKey(bytes(range(32)))
KIND = 6


class KeyedController(ControllerUnderTest):
    """A sound controller that has a key."""

    link_key: LinkKey = KEY

    def expected(self, data: bytes) -> DirectionKey | None:
        """The key that a datagram must be signed with."""
        if data[KIND] == Kind.HELLO:
            return KEY.of_hello()
        return next((keys.receives for keys in self._open_keys(data)), None)

    def own(self, data: bytes) -> DirectionKey | None:
        """The key that the controller itself signs with in the datagram's session."""
        return next((keys.sends for keys in self._open_keys(data)), None)

    def _open_keys(self, data: bytes) -> list[channel.ChannelKeys]:
        sessions = (self.server._session, self.server._unconfirmed)
        number = int.from_bytes(data[16:24], "little")
        return [s.channel.keys for s in sessions if s and s.channel.session == number and s.channel.keys]

    def signed(self, data: bytes) -> bytes:
        """``data`` as if it had been signed rightly, whatever its tag and whether it has one."""
        key = self.expected(data)
        try:
            header, message = decode(data)
        except DatagramRefused:
            return data
        if key is None:
            return data
        if not header.flags & 0x100:
            newest = self.server._session.channel._window.newest if self.server._session else 0
            header = header._replace(sequence=header.sequence + (newest >> 32 << 32))
        return encode(message, header, key)

    def server_of(self, cls: type[ReferenceServer]) -> ReferenceServer:
        """A server of another class."""
        return cls(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, key=KEY)


class TakesAnyTag(KeyedController):
    """Looks for a tag, and not at it."""

    def incoming(self, data: bytes) -> bytes | None:
        flagged = len(data) >= 64 and data[9] & 1
        return self.signed(data) if flagged else data


class ComparesFourBytes(KeyedController):
    """Compares the first four bytes of the tag alone."""

    def incoming(self, data: bytes) -> bytes | None:
        key = self.expected(data) if len(data) >= 64 else None
        if key is None or key.tag(data[:-TAG_BYTES])[:4] != data[-TAG_BYTES:][:4]:
            return data
        return self.signed(data)


class SignsThePayloadAlone(KeyedController):
    """Lets the tag pass whatever bit of the header was changed: it finds the signed one by trying."""

    def incoming(self, data: bytes) -> bytes | None:
        key = self.expected(data) if len(data) >= 64 else None
        if key is not None and any(
            fault_of(with_bit_flipped(data, bit), 0x100, key) is None for bit in range(8 * HEADER_BYTES)
        ):
            return self.signed(data)
        return data


class TakesUnsigned(KeyedController):
    """Checks a tag where there is one."""

    def incoming(self, data: bytes) -> bytes | None:
        return data if len(data) < 40 or data[9] & 1 or data[KIND] == Kind.HELLO else self.signed(data)


class Downgrades(KeyedController):
    """Grants a session without authentication to whoever does not ask for it."""

    def incoming(self, data: bytes) -> bytes | None:
        hello = len(data) > 40 and data[KIND] == Kind.HELLO
        return self.signed(data) if hello and not data[9] & 1 else data


class TakesAnyKeyForHello(KeyedController):
    """Answers a HELLO of any key."""

    def incoming(self, data: bytes) -> bytes | None:
        return self.signed(data) if len(data) > 40 and data[KIND] == Kind.HELLO else data


class HasOneKeyForBothWays(KeyedController):
    """Takes its own signature for the client's."""

    def incoming(self, data: bytes) -> bytes | None:
        key = self.own(data) if len(data) >= 64 else None
        return self.signed(data) if key and fault_of(data, 0x100, key) is None else data


class TakesTheKeyOfHello(KeyedController):
    """Takes the key that is the same in every session, in sessions as well."""

    def incoming(self, data: bytes) -> bytes | None:
        sound = len(data) >= 64 and fault_of(data, 0x100, KEY.of_hello()) is None
        return self.signed(data) if sound else data


class UsesReplays(KeyedController):
    """Does not look whether a number came before."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), NoDuplicates)


class _LowerHalf(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        arrival, skipped = super().arrive(sequence % 2**32)
        return arrival, skipped


class LeavesTheUpperHalfOut(KeyedController):
    """Tells replays by the lower half of the number."""

    def make_server(self) -> ReferenceServer:
        server = super().make_server()
        granted = server._granted

        def bent(header: Header, *args: object) -> object:
            session = granted(header, *args)
            session.channel._window = _LowerHalf(header.sequence % 2**32)
            return session

        server._granted = bent
        return server


class CountsReplaysOff(KeyedController):
    """Takes every late datagram off the losses, whether it came before or not."""

    def make_server(self) -> ReferenceServer:
        class Forgetful(channel.SequenceWindow):
            def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
                arrival, skipped = super().arrive(sequence)
                late = arrival is channel.Arrival.DUPLICATE and sequence != self.newest
                return (channel.Arrival.LATE if late else arrival), skipped

        return with_window(super().make_server(), Forgetful)


class BeginsWithAnything(KeyedController):
    """Begins a session with whatever names it, before it looks at the tag."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                granted = self._unconfirmed
                named = granted and data[16:24] == granted.channel.session.to_bytes(8, "little")
                begun = self._confirmed(now_ns) if named else []
                return begun + super().receive(data, source, now_ns)

        return self.server_of(Server)


class TakesForgeriesForLife(KeyedController):
    """Takes a forged datagram for a sign of life."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                if self._session:
                    self._session.channel.heard_ns = now_ns
                return super().receive(data, source, now_ns)

        return self.server_of(Server)


class CountsBeforeItChecks(KeyedController):
    """Lets a forged datagram move the count."""

    def make_server(self) -> ReferenceServer:
        class Server(ReferenceServer):
            def receive(self, data: bytes, source: object, now_ns: int) -> list[ServerEvent]:
                events = super().receive(data, source, now_ns)
                forged = [e for e in events if isinstance(e, DatagramDropped) and "bad_tag" in e.cause]
                if forged and self._session:
                    tally = LinkStatistics()
                    self._session.channel.hear(decode(data).header, now_ns, None, tally)
                return events

        return self.server_of(Server)


class CountsNoForgeries(KeyedController):
    """Keeps its refusals to itself."""

    def shown(self, state: State) -> State:
        return state._replace(references_dropped=0)


class SignsSparingly(KeyedController):
    """Leaves every 40th datagram unsigned."""

    count = 0

    def outgoing(self, data: bytes) -> list[bytes]:
        self.count += 1
        if self.count % 40:
            return [data]
        bare = bytearray(data[:-TRAILER_BYTES])
        bare[9] = 0
        return [resealed(bytes(bare))]


class ObeysUnsignedByes(KeyedController):
    """Ends the session for a BYE that anybody may have sent."""

    def incoming(self, data: bytes) -> bytes | None:
        bye = len(data) > 40 and data[KIND] == Kind.BYE and not data[9] & 1
        return self.signed(data) if bye else data


KEY_MUTANTS = (
    Mutant(Downgrades, 701),
    Mutant(TakesAnyKeyForHello, 702),
    Mutant(TakesAnyKeyForHello, 703),
    Mutant(TakesAnyTag, 704),
    Mutant(ComparesFourBytes, 704),
    Mutant(SignsThePayloadAlone, 705),
    Mutant(TakesUnsigned, 706),
    Mutant(HasOneKeyForBothWays, 707),
    Mutant(TakesTheKeyOfHello, 708),
    Mutant(UsesReplays, 709),
    Mutant(LeavesTheUpperHalfOut, 711),
    Mutant(BeginsWithAnything, 713),
    Mutant(TakesForgeriesForLife, 715),
    Mutant(CountsBeforeItChecks, 716),
    Mutant(CountsNoForgeries, 717),
    Mutant(SignsSparingly, 718),
    Mutant(ObeysUnsignedByes, 719),
    Mutant(CountsReplaysOff, 721),
)
