"""Controllers wrong in the form, order or age of datagrams, each with its case."""

import struct

from conformance.bytes_of import resealed, with_number
from protocol import channel
from protocol.datagram_layout import Kind
from protocol.reference_messages import (
    HeartbeatReply,
    State,
)
from protocol.server_session import ReferenceServer
from tests.conformance.controllers import LINK_TIMEOUT_MS, ControllerUnderTest
from tests.conformance.mutants.breaking import (
    ECHO,
    FLAGS,
    HEADER_BYTES,
    LENGTH,
    MAJOR,
    MINOR,
    SEQUENCE,
    Mutant,
    reworked,
    with_window,
)


class NoCrc(ControllerUnderTest):
    """Does not look at the CRC."""

    def incoming(self, data: bytes) -> bytes | None:
        return resealed(data) if len(data) >= HEADER_BYTES else data


class NoMagic(ControllerUnderTest):
    """Does not look at the magic."""

    def incoming(self, data: bytes) -> bytes | None:
        return resealed(b"LRLK" + data[4:]) if len(data) >= HEADER_BYTES and _sound_crc(data) else data


class IgnoresTrailingBytes(ControllerUnderTest):
    """Reads what the length field says and leaves the rest."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < HEADER_BYTES:
            return data
        wanted = HEADER_BYTES + struct.unpack_from("<H", data, LENGTH)[0]
        return resealed(data[:wanted]) if len(data) > wanted else data


class FillsUpShortDatagrams(ControllerUnderTest):
    """Takes the missing bytes of a COMMAND for zero."""

    def incoming(self, data: bytes) -> bytes | None:
        if not HEADER_BYTES <= len(data) < 56 or data[6] != Kind.COMMAND:
            return data
        return with_number(data + bytes(56 - len(data)), LENGTH, "H", 16)


class IgnoresCriticalFlags(ControllerUnderTest):
    """Ignores every flag."""

    def incoming(self, data: bytes) -> bytes | None:
        if len(data) < HEADER_BYTES or not _sound_crc(data):
            return data
        return with_number(data, FLAGS, "H", data[FLAGS])


class IgnoresTheMajorVersion(ControllerUnderTest):
    """Takes any major version for its own."""

    def incoming(self, data: bytes) -> bytes | None:
        return with_number(data, MAJOR, "B", 1) if len(data) >= HEADER_BYTES and _sound_crc(data) else data


class MoreMinor(ControllerUnderTest):
    """Sends another minor version than it negotiated."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [data if data[6] == 2 else with_number(data, MINOR, "B", 3)]


class NumbersFromAByte(ControllerUnderTest):
    """Keeps its own sequence number in one byte."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, first_sequence=250)

    def outgoing(self, data: bytes) -> list[bytes]:
        return [with_number(data, SEQUENCE, "I", struct.unpack_from("<I", data, SEQUENCE)[0] & 0xFF)]


class EchoesTheFirst(ControllerUnderTest):
    """Echoes a number that is not the newest."""

    def outgoing(self, data: bytes) -> list[bytes]:
        echo = struct.unpack_from("<I", data, ECHO)[0]
        return [with_number(data, ECHO, "I", max(echo - 1, 0))]


class StampsInMicroseconds(ControllerUnderTest):
    """Answers heartbeats in microseconds."""

    def outgoing(self, data: bytes) -> list[bytes]:
        def coarse(m: HeartbeatReply) -> HeartbeatReply:
            return m._replace(received_ns=m.received_ns // 1000, replied_ns=m.replied_ns // 1000)

        return [reworked(data, HeartbeatReply, coarse)]


class StampsBackwards(ControllerUnderTest):
    """Claims to have replied before it received."""

    def outgoing(self, data: bytes) -> list[bytes]:
        return [reworked(data, HeartbeatReply, lambda m: m._replace(received_ns=m.replied_ns + 1000))]


class _AnyOrder(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        arrival, _ = super().arrive(sequence)
        self.newest = sequence
        return (arrival if arrival is channel.Arrival.DUPLICATE else channel.Arrival.NEW), 0


class _Plain(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        if sequence <= self.newest:
            return channel.Arrival.OLD, 0
        skipped, self.newest = sequence - self.newest - 1, sequence
        return channel.Arrival.NEW, skipped


class NoDuplicates(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        arrival, skipped = super().arrive(sequence)
        return (channel.Arrival.NEW if arrival is channel.Arrival.DUPLICATE else arrival), skipped


class _AnyLeap(channel.SequenceWindow):
    def arrive(self, sequence: int) -> tuple[channel.Arrival, int]:
        if 0 < (sequence - self.newest) % 2**32 < 2**31:
            self.newest = sequence
            return channel.Arrival.NEW, 0
        return super().arrive(sequence)


class UsesLateDatagrams(ControllerUnderTest):
    """Drops duplicates only."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), _AnyOrder)


class DoesNotWrap(ControllerUnderTest):
    """Compares sequence numbers as plain numbers."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), _Plain)


class UsesDuplicates(ControllerUnderTest):
    """Drops older numbers, but not the same again."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), NoDuplicates)


class FollowsAnyLeap(ControllerUnderTest):
    """Follows a leap of any size."""

    def make_server(self) -> ReferenceServer:
        return with_window(super().make_server(), _AnyLeap)


class UsesStaleDatagrams(ControllerUnderTest):
    """Judges by sequence alone."""

    def make_server(self) -> ReferenceServer:
        return ReferenceServer(77, self.arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, max_age_ms=10**6)


class CountsNoLosses(ControllerUnderTest):
    """Shows no losses."""

    def shown(self, state: State) -> State:
        return state._replace(references_lost=0)


DATAGRAM_MUTANTS = (
    Mutant(NoMagic, 102),
    Mutant(FillsUpShortDatagrams, 104),
    Mutant(IgnoresTrailingBytes, 107),
    Mutant(NoCrc, 109),
    Mutant(NoCrc, 111),
    Mutant(IgnoresTheMajorVersion, 112),
    Mutant(IgnoresTheMajorVersion, 113),
    Mutant(IgnoresCriticalFlags, 116),
    Mutant(MoreMinor, 229),
    Mutant(UsesDuplicates, 301),
    Mutant(UsesLateDatagrams, 302),
    Mutant(FollowsAnyLeap, 305),
    Mutant(DoesNotWrap, 307),
    Mutant(CountsNoLosses, 310),
    Mutant(NumbersFromAByte, 311),
    Mutant(EchoesTheFirst, 312),
    Mutant(UsesStaleDatagrams, 313),
    Mutant(UsesStaleDatagrams, 314),
    Mutant(StampsBackwards, 317),
    Mutant(StampsInMicroseconds, 318),
)


def _sound_crc(data: bytes) -> bool:
    return data == resealed(data)
