"""Cases 101…: what is a datagram and what is not (clause 3)."""

import struct
from collections.abc import Callable, Iterable, Iterator

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.wire import require, with_bit_flipped
from protocol.datagram_layout import HEADER_BYTES, MAX_DATAGRAM_BYTES
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Bye,
    Command,
    Hello,
    Message,
    ReferencePath,
    Welcome,
)

case = reference.case
PATHS = OptionalPart.PATHS
MAJOR, KIND, SPARE, FLAGS = 4, 6, 7, 8
COMMAND_BYTES = 16


def stop(peer: Peer) -> Command:
    """A command that every controller accepts in every state (7.3)."""
    return Command(peer.new_id(), CommandCode.STOP)


def refused(peer: Peer, bent: Iterable[bytes], what: str) -> None:
    """The bent requests get no answer, and the session lives on."""
    for data in bent:
        peer.send_raw(data)
    answers = peer.answers(what)
    require(not answers, f"{what}: {len(answers)} of them were answered")


def used(peer: Peer, data: bytes, command_id: int, what: str) -> None:
    """The bent request is answered all the same."""
    peer.send_raw(data)
    answer = peer.answer_to(command_id, what)
    require(answer.reason is Reason.ACCEPTED, f"{what}: answered {answer.reason.name}")


def in_a_session(message: Callable[[Peer], Message]) -> Callable[[Peer], bytes]:
    """Opens a session and seals a message in it."""

    def encoded(peer: Peer) -> bytes:
        peer.open()
        return peer.encoded(message(peer))

    return encoded


a_stop = in_a_session(stop)
a_path = in_a_session(lambda peer: ReferencePath(peer.new_id(), (IDENTITY,) * 3, 0.0, 0.0))


@case(101, "3.1", "a sound request is answered (the control of the cases below)")
def sound(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    used(peer, peer.encoded(request), request.command_id, "STOP")


@case(102, "3.5", "every other magic is dropped")
def magic(peer: Peer) -> None:
    data = a_stop(peer)
    refused(peer, [peer.resealed(with_bit_flipped(data, bit)) for bit in range(32)], "a wrong magic")


@case(103, "3.5", "COMMAND truncated at every byte is dropped")
def truncated_command(peer: Peer) -> None:
    data = a_stop(peer)
    refused(peer, [data[:n] for n in range(1, len(data))], "a truncated COMMAND")


@case(104, "3.5", "COMMAND truncated at every byte, its length field made to match, is dropped")
def truncated_and_confessed(peer: Peer) -> None:
    data = a_stop(peer)
    bent = [peer.with_payload_of(data, n) for n in range(COMMAND_BYTES)]
    refused(peer, bent, "a shortened COMMAND")


@case(105, "3.5", "REFERENCE_PATH truncated at every 8th byte is dropped")
def truncated_path(peer: Peer) -> None:
    data = a_path(peer)
    refused(peer, [data[:n] for n in range(HEADER_BYTES, len(data), 8)], "a truncated REFERENCE_PATH")


@case(106, "3.5", "a datagram without content is dropped")
def empty(peer: Peer) -> None:
    peer.open()
    refused(peer, [b""] * 3, "an empty datagram")


@case(107, "3.5", "trailing bytes are dropped, whether the length field admits them or not")
def trailing(peer: Peer) -> None:
    data = a_stop(peer)
    longer = [data + bytes(n) for n in (1, 8, 100)]
    admitted = [peer.with_payload_of(data, COMMAND_BYTES + n) for n in (1, 8, 100)]
    refused(peer, [*longer, *admitted], "a COMMAND with trailing bytes")


@case(108, "3.5", "datagrams above the largest size are dropped")
def oversize(peer: Peer) -> None:
    data = a_path(peer)
    sizes = (MAX_DATAGRAM_BYTES + 1, 1472, 1473, 9000, 60_000)
    refused(peer, [peer.with_payload_of(data, n - HEADER_BYTES) for n in sizes], "an oversize datagram")


@case(109, "3.2", "COMMAND with any single bit flipped is dropped")
def flipped_command(peer: Peer) -> None:
    data = a_stop(peer)
    refused(peer, [with_bit_flipped(data, bit) for bit in range(8 * len(data))], "a flipped bit")


@case(111, "3.2", "a CRC over the field itself, of zero, or of another polynomial is refused")
def other_crc(peer: Peer) -> None:
    data = a_stop(peer)
    crc32c = struct.pack("<I", _crc(data[:12] + data[16:], 0x82F63B78))
    big_endian = data[:12] + data[12:16][::-1] + data[16:]
    refused(
        peer, [data[:12] + bytes(4) + data[16:], data[:12] + crc32c + data[16:], big_endian], "a wrong CRC"
    )


@case(112, "4.4", "another major version is told INCOMPATIBLE_VERSION")
def major(peer: Peer) -> None:
    hello = peer.encoded(Hello(peer.nonce(), 1, 0, 50), session=0)
    for version in (0, 2, 255):
        peer.collect(RATION_MS)
        peer.send_raw(peer.with_number(hello, MAJOR, "B", version))
        peer.expect_bye(Reason.INCOMPATIBLE_VERSION, f"HELLO of major version {version}")


@case(114, "4.2", "a newer minor version is met with the controller's own")
def newer_minor(peer: Peer) -> None:
    peer.open(minor=200)
    require(peer.minor < 200, f"WELCOME has minor {peer.minor}: higher than any published version")
    peer.alive("the negotiated minor version")


@case(116, "3.4", "each unknown critical flag is refused")
def critical(peer: Peer) -> None:
    data = a_stop(peer)
    flags = [int.from_bytes(data[FLAGS : FLAGS + 2], "little") | 1 << bit for bit in range(9, 16)]
    refused(peer, [peer.with_number(data, FLAGS, "H", each) for each in flags], "a critical flag")


@case(117, "3.4", "unknown optional flags are ignored")
def optional(peer: Peer) -> None:
    peer.open()
    for flags in (*(1 << bit for bit in range(1, 8)), 0xFF):
        request = stop(peer)
        used(peer, peer.encoded(request, flags=flags), request.command_id, f"optional flags {flags:#x}")


@case(118, "3.5", "unknown kinds are dropped")
def kinds(peer: Peer) -> None:
    data = a_stop(peer)
    refused(peer, [peer.with_number(data, KIND, "B", kind) for kind in (0, 100, 127, 255)], "an unknown kind")


@case(119, "3.5", "a payload of another kind's length is dropped")
def other_length(peer: Peer) -> None:
    data = a_stop(peer)
    refused(
        peer,
        [peer.with_number(data, KIND, "B", kind) for kind in (3, 5, 6)],
        "COMMAND's payload as another kind",
    )


@case(121, "3.5", "a command id of 0 is dropped")
def id_zero(peer: Peer) -> None:
    refused(peer, [peer.with_number(a_stop(peer), HEADER_BYTES, "Q", 0)], "command id 0")


@case(122, "3.5", "HELLO with a nonce of 0 or a STATE period above the range is dropped")
def bad_hello(peer: Peer) -> None:
    hello = peer.encoded(Hello(peer.nonce(), 1, 0, 50), session=0)
    peer.send_raw(peer.with_number(hello, HEADER_BYTES, "Q", 0))
    peer.send_raw(peer.with_number(hello, HEADER_BYTES + 24, "I", 60_001))
    got = [d.message for d in peer.collect(100) if isinstance(d.message, Welcome | Bye)]
    require(not got, f"a HELLO out of range was answered with {got}")


@case(127, "3.5", "noise behind a good header and CRC is survived")
def sealed_noise(peer: Peer) -> None:
    data = a_stop(peer)
    generator = _noise(peer.session & 0xFFFFFFFF or 1)
    for kind in range(16):
        for size in (0, 8, 16, 32, 48, 72, 336, 1376):
            payload = bytes(next(generator) & 0xFF for _ in range(size))
            bent = bytearray(peer.with_payload_of(data, size))
            bent[KIND] = kind
            bent[HEADER_BYTES : HEADER_BYTES + size] = payload
            struct.pack_into("<Q", bent, 16, peer.session ^ 1)
            peer.send_raw(peer.resealed(bytes(bent)))
    peer.collect(RATION_MS)
    peer.alive("after noise behind good headers")


def _crc(data: bytes, polynomial: int) -> int:
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (polynomial if register & 1 else 0)
    return register ^ 0xFFFFFFFF


def _noise(seed: int) -> Iterator[int]:
    """Xorshift numbers: the same for the same session number, so a transcript can be made again."""
    x = seed & 0xFFFFFFFF or 1
    while True:
        x ^= x << 13 & 0xFFFFFFFF
        x ^= x >> 17
        x ^= x << 5 & 0xFFFFFFFF
        yield x
