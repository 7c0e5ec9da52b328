"""A million bent inputs to every decoder: a typed refusal or a sound value, never anything else."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from conformance.wire import resealed
from protocol.client_session import ReferenceClient
from protocol.datagram import decode, encode
from protocol.errors import DatagramRefused, FrameRefused, ImageRefused
from protocol.process_image import decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.stereo_frame import decode_header, encode_header
from tests.protocol.test_process_image import SENSORS, VALVES
from tests.protocol.test_stereo_frame import HEADER as FRAME
from tests.protocol.wire import Wire
from tools.sample_messages import HEADER, MESSAGES

INPUTS = 1_000_000


def bent(rng: np.random.Generator, sound: bytes, count: int) -> list[bytes]:
    """``count`` variants of ``sound``: bytes replaced, cut off, put on."""
    places = rng.integers(0, len(sound), (count, 3))
    values = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    hows = rng.integers(0, 12, count)
    variants = []
    for (a, b, c), (x, y, z), how in zip(places.tolist(), values.tolist(), hows.tolist(), strict=True):
        data = bytearray(sound)
        data[a] = x
        if how > 3:
            data[b] = y
        if how > 7:
            data[c] = z
        if how == 0:
            del data[c:]
        elif how == 1:
            data += bytes((x, y, z))
        variants.append(bytes(data))
    return variants


def refuses(decoder: Callable[[bytes], object], data: bytes, refusal: type[Exception]) -> bool:
    try:
        decoder(data)
    except refusal:
        return True
    return False


@pytest.mark.experiment
def test_datagrams() -> None:
    rng = np.random.default_rng(1)
    refused = 0
    for message in MESSAGES:
        sound = encode(message, HEADER)
        for data in bent(rng, sound, INPUTS // len(MESSAGES)):
            refused += refuses(decode, resealed(data) if len(data) > 40 else data, DatagramRefused)
    assert 0.02 * INPUTS < refused < 0.98 * INPUTS


@pytest.mark.experiment
def test_sessions() -> None:
    rng = np.random.default_rng(2)
    wire = Wire(client=ReferenceClient(7)).connect()
    session = wire.server.session or 0
    for message in MESSAGES:
        sound = encode(message, HEADER._replace(session=session))
        for data in bent(rng, sound, 20_000):
            encoded = resealed(data) if len(data) > 40 else data
            wire.server.receive(encoded, wire.source, wire.server_ns)
            wire.client.receive(encoded, wire.now_ns)
            wire.server.outgoing(wire.server_ns)
            wire.client.outgoing(wire.now_ns)


@pytest.mark.experiment
def test_images_and_frames() -> None:
    rng = np.random.default_rng(3)
    sensors = struct.pack("<40H", *encode_sensors(SENSORS))
    valves = struct.pack("<12H", *encode_valves(VALVES))
    cases = (
        (sensors, decode_sensors, ImageRefused),
        (valves, decode_valves, ImageRefused),
        (encode_header(FRAME), decode_header, FrameRefused),
    )
    for sound, decoder, refusal in cases:
        for data in bent(rng, sound, 50_000):
            if decoder is decode_header:
                refuses(decode_header, data, refusal)
            else:
                words = list(struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2]))
                refuses(decoder, words, refusal)
