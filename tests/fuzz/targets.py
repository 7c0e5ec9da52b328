"""What is fuzzed: every decoder that reads a stranger's bytes, as a function of those bytes.

A target returns whether the input was accepted. It lets pass only the typed refusal that the decoder's
docstring names; any other exception is a finding.
"""

import struct
from collections.abc import Callable
from zlib import crc32

from pymodbus.pdu import DecodePDU

from foundation.modbus import MAX_PDU_BYTES, PlaceLost, StreamFramer, decoded
from plant_emulator.shell.coupler import Coupler
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.errors import DatagramRefused, FrameRefused, ImageRefused
from protocol.process_image import (
    SensorImage,
    ValveImage,
    decode_sensors,
    decode_valves,
    encode_sensors,
    encode_valves,
)
from protocol.stereo_frame import HEADER_BYTES as FRAME_BYTES
from protocol.stereo_frame import FrameHeader, decode_header, encode_header
from tests.protocol.sample_messages import MESSAGES
from tests.protocol.wire import Wire

_SENSORS = encode_sensors(SensorImage(7, 9, 3, (1, -2, 3, -4, 5, 6), ((50.0, 60.0),) * 6, 190.0, 10.0, 40.0))
_VALVES = encode_valves(ValveImage(9, 1, (0.5, -0.5, 0.0, 1.0, -1.0, 0.1)))
_CRC = struct.Struct("<I")


def _repaired(data: bytes, session: int | None = None) -> bytes:
    """``data`` with magic, version, length and sum made right, to reach the checks behind them."""
    body = bytearray(data.ljust(HEADER_BYTES, b"\0"))
    body[:5] = b"LRLK\x01"
    body[10:12] = struct.pack("<H", (len(body) - HEADER_BYTES) & 0xFFFF)
    if session is not None:
        body[16:24] = struct.pack("<Q", session)
    body[12:16] = _CRC.pack(crc32(body[16:], crc32(body[:12])))
    return bytes(body)


def datagram(data: bytes) -> bool:
    """A datagram of the reference link; the first byte says whether its header is repaired."""
    if not data:
        return False
    try:
        decode(_repaired(data[1:]) if data[0] & 1 else data[1:])
    except DatagramRefused:
        return False
    return True


_WIRE = Wire().connect()


def session(data: bytes) -> bool:
    """A datagram in an open session, to either end: no exception at all, whatever it says."""
    if not data:
        return False
    if _WIRE.server.session is None:
        _WIRE.__init__()  # type: ignore[misc]
        _WIRE.connect()
    sealed = _repaired(data[1:], _WIRE.server.session)
    if data[0] & 1:
        events = _WIRE.client.receive(sealed, _WIRE.now_ns)
        _WIRE.client.outgoing(_WIRE.now_ns)
    else:
        events = _WIRE.server.receive(sealed, _WIRE.source, _WIRE.server_ns)  # type: ignore[assignment]
        _WIRE.server.outgoing(_WIRE.server_ns)
    return bool(events)


def image(data: bytes) -> bool:
    """A process image: sensors, or valves if the first byte is odd."""
    words = list(struct.unpack(f"<{len(data[1:]) // 2}H", data[1:][: len(data[1:]) // 2 * 2]))
    try:
        decode_valves(words) if data[:1] and data[0] & 1 else decode_sensors(words)
    except ImageRefused:
        return False
    return True


def _coupler() -> Coupler:
    return Coupler(lambda: _SENSORS, lambda _: None, 1_000_000_000, lambda: 0)


_COUPLER = _coupler()


def modbus(data: bytes) -> bool:
    """A Modbus request: always an answer, an exception or what was asked for, to the same function code."""
    request = data[:MAX_PDU_BYTES] or b"\0"
    answer = _COUPLER.answer("master", 1, request)
    assert answer[0] & 0x7F == request[0] & 0x7F, (request.hex(), answer.hex())
    assert 2 <= len(answer) <= MAX_PDU_BYTES, (request.hex(), len(answer))
    return not answer[0] & 0x80


_FRAMER = StreamFramer(DecodePDU(is_server=False))


def stream(data: bytes) -> bool:
    """Bytes on a Modbus TCP connection, in two pieces; accepted: the connection is kept."""
    held, cut = b"", data[0] % len(data) if data else 0
    try:
        for piece in (data[1:cut], data[max(cut, 1) :]):
            held += piece
            while (frame := _FRAMER.decode(held))[0]:
                used, unit, transaction, pdu = frame
                held = held[used:]
                answer = _COUPLER.answer("stream", unit, pdu)
                sent = _FRAMER.encode(answer, unit, transaction)
                assert _FRAMER.decode(sent + b"\0") == (len(sent), unit, transaction, answer)
    except PlaceLost:
        return False
    assert len(held) < MAX_PDU_BYTES + 7, len(held)
    return True


def answer(data: bytes) -> bool:
    """What a plant may answer to the controller: decoded or refused, and no exception."""
    return bool(data) and decoded(_FRAMER.decoder, data) is not None


def frame(data: bytes) -> bool:
    """The header of a stereo frame."""
    try:
        decode_header(data[:FRAME_BYTES].ljust(FRAME_BYTES, b"\0") if data[:1] == b"L" else data)
    except FrameRefused:
        return False
    return True


_HEADER = Header(1, 2, 3, 4, 0, 0)
_REQUESTS = [
    bytes.fromhex(text)
    for text in (
        "01 0000 0010", "02 0000 0010", "03 0000 0028", "04 0000 0028", "05 0000 FF00", "06 0802 0001",
        "08 0000 1234", "0F 0000 0008 01 55", "10 0800 0002 04 3FFF 7FFF", "06 1121 BECF", "06 1120 0064",
        "17 0000 0002 0800 0002 04 3FFF 7FFF",
    )
]  # fmt: skip
TARGETS: dict[str, tuple[Callable[[bytes], bool], list[bytes]]] = {
    "datagram": (datagram, [bytes([k]) + encode(m, _HEADER) for m in MESSAGES for k in (0, 1)]),
    "session": (session, [bytes([k]) + encode(m, _HEADER) for m in MESSAGES for k in (0, 1)]),
    "image": (
        image,
        [b"\0" + struct.pack("<40H", *_SENSORS), b"\1" + struct.pack("<12H", *_VALVES), b"\1" + bytes(24)],
    ),
    "modbus": (modbus, _REQUESTS),
    "stream": (stream, [b"\5" + struct.pack(">HHHB", 1, 0, len(r) + 1, 1) + r for r in _REQUESTS]),
    "answer": (answer, [_COUPLER.answer("seed", 1, request) for request in _REQUESTS]),
    "frame": (frame, [encode_header(FrameHeader(1, 2, 3, 1280, 720, 4, 0))]),
}
