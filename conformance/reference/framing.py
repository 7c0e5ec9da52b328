"""Cases 101…: what is a datagram and what is not (clause 3)."""

import struct
from collections.abc import Callable, Iterable
from functools import partial
from random import Random
from typing import Any

from conformance.case import case
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
    ReferencePath,
    Welcome,
)

PATHS = OptionalPart.PATHS
MAJOR, KIND, FLAGS = 4, 6, 8
COMMAND_BYTES = 16


def flags_of(data: bytes) -> int:
    """The flags in the header of a datagram."""
    return int.from_bytes(data[FLAGS : FLAGS + 2], "little")


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


def used_next(peer: Peer, what: str, **header: int) -> None:
    """A sound request is answered; ``header``: fields of it."""
    request = stop(peer)
    used(peer, peer.encoded(request, **header), request.command_id, what)


def a_path(peer: Peer) -> bytes:
    """A path of three waypoints, sealed in the session."""
    return peer.encoded(ReferencePath(peer.new_id(), (IDENTITY,) * 3, 0.0, 0.0))


# Of a peer in a session and a sealed STOP: datagrams that are to be dropped.
Bent = Callable[[Peer, bytes], Iterable[bytes]]


def all_refused(rows: Iterable[tuple[int, str, str, Bent]], enter: Callable[..., Any]) -> None:
    """Enter a case for each row: number, clause, title, and what gets no answer."""

    def refusing(bent: Bent, title: str, peer: Peer) -> None:
        refused(peer, bent(peer, peer.encoded(stop(peer))), title)

    for number, clause, title, bent in rows:
        enter(number, clause, title, opens=50)(partial(refusing, bent, title))


@case(101, "3.1", "a sound request is answered (the control of the cases below)", opens=50)
def sound(peer: Peer) -> None:
    used_next(peer, "STOP")


# fmt: off - one case a row
all_refused(
    (
        (
            102,
            "3.5",
            "every other magic is dropped",
            lambda peer, data: (peer.resealed(with_bit_flipped(data, bit)) for bit in range(32)),
        ),
        (
            103,
            "3.5",
            "COMMAND truncated at every byte is dropped",
            lambda _, data: (data[:n] for n in range(1, len(data))),
        ),
        (
            104,
            "3.5",
            "COMMAND truncated at every byte, its length field made to match, is dropped",
            lambda peer, data: (peer.with_payload_of(data, n) for n in range(COMMAND_BYTES)),
        ),
        (
            105,
            "3.5",
            "REFERENCE_PATH truncated at every 8th byte is dropped",
            lambda peer, _: (path[:n] for path in [a_path(peer)] for n in range(HEADER_BYTES, len(path), 8)),
        ),
        (106, "3.5", "a datagram without content is dropped", lambda _, __: [b""] * 3),
        (
            107,
            "3.5",
            "trailing bytes are dropped, whether the length field admits them or not",
            lambda peer, data: (
                bent
                for n in (1, 8, 100)
                for bent in (data + bytes(n), peer.with_payload_of(data, COMMAND_BYTES + n))
            ),
        ),
        (
            108,
            "3.5",
            "datagrams above the largest size are dropped",
            lambda peer, _: (
                peer.with_payload_of(a_path(peer), n - HEADER_BYTES)
                for n in (MAX_DATAGRAM_BYTES + 1, 1472, 1473, 9000, 60_000)
            ),
        ),
        (
            109,
            "3.2",
            "COMMAND with any single bit flipped is dropped",
            lambda _, data: (with_bit_flipped(data, bit) for bit in range(8 * len(data))),
        ),
        (
            111,
            "3.2",
            "a CRC over the field itself, of zero, or of another polynomial is refused",
            lambda _, data: (
                data[:12] + crc + data[16:]
                for crc in (
                    bytes(4),
                    struct.pack("<I", _crc(data[:12] + data[16:], 0x82F63B78)),
                    data[12:16][::-1],
                )
            ),
        ),
        (
            141,
            "3.2",
            "REFERENCE_PATH with a bit flipped in any of its bytes is dropped",
            lambda peer, _: (
                with_bit_flipped(path, bit) for path in [a_path(peer)] for bit in range(0, 8 * len(path), 29)
            ),
        ),
        (
            116,
            "3.4",
            "each unknown critical flag is refused",
            lambda peer, _: (peer.encoded(stop(peer), flags=1 << bit) for bit in range(9, 16)),
        ),
        (
            118,
            "3.5",
            "unknown kinds are dropped",
            lambda peer, data: (peer.with_number(data, KIND, "B", kind) for kind in (0, 100, 127, 255)),
        ),
        (
            119,
            "3.5",
            "a payload of another kind's length is dropped",
            lambda peer, data: (peer.with_number(data, KIND, "B", kind) for kind in (3, 5, 6)),
        ),
        (
            121,
            "3.5",
            "a command id of 0 is dropped",
            lambda peer, data: [peer.with_number(data, HEADER_BYTES, "Q", 0)],
        ),
    ),
    case,
)
# fmt: on


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


@case(117, "3.4", "unknown optional flags are ignored", opens=50)
def optional(peer: Peer) -> None:
    for flags in (*(1 << bit for bit in range(1, 8)), 0xFF):
        used_next(peer, f"optional flags {flags:#x}", flags=flags)


@case(122, "3.5", "HELLO with a nonce of 0 or a STATE period above the range is dropped")
def bad_hello(peer: Peer) -> None:
    hello = peer.encoded(Hello(peer.nonce(), 1, 0, 50), session=0)
    peer.send_raw(peer.with_number(hello, HEADER_BYTES, "Q", 0))
    peer.send_raw(peer.with_number(hello, HEADER_BYTES + 24, "I", 60_001))
    peer.require_came([], 100, "a HELLO out of range", of=Welcome | Bye, beating=True)


@case(127, "3.5", "noise behind a good header and CRC is survived", opens=50)
def sealed_noise(peer: Peer) -> None:
    data = peer.encoded(stop(peer))
    noise = Random(peer.session)  # so a transcript can be made again
    for kind in range(16):
        for size in (0, 8, 16, 32, 48, 72, 336, 1376):
            bent = bytearray(peer.with_payload_of(data, size))
            bent[KIND] = kind
            bent[HEADER_BYTES : HEADER_BYTES + size] = noise.randbytes(size)
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
