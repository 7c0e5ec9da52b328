"""Cost of one reference and one state, encode + decode, against two peers that others would reach for.

``json``: the same header and fields as a JSON object, unchecked. ``bare struct``: one hand-written
``struct`` format and a CRC, no ranges, no named fields, no typed refusals: the floor for pure Python.
"""

import json
import struct
from collections.abc import Callable
from typing import Any
from zlib import crc32

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from protocol.reference_link import Message, ReferencePose, State, decode, encode
from tests.protocol.samples import HEADER, MESSAGES

REFERENCE = next(m for m in MESSAGES if isinstance(m, ReferencePose))
STATE = next(m for m in MESSAGES if isinstance(m, State))
BARE = {
    ReferencePose: struct.Struct("<4sBBBBHHIQIIQQ8d"),
    State: struct.Struct("<4sBBBBHHIQIIQQQ4HQII18d14dd8I"),
}


def through_ours(message: Message) -> Any:
    return decode(encode(message, HEADER)).message


def through_json(message: Message) -> Any:
    text = json.dumps({"header": HEADER._asdict(), "fields": message._asdict()}).encode()
    return json.loads(text)["fields"]


def through_bare_struct(message: Message) -> Any:
    layout = BARE[type(message)]
    numbers: list[float] = []
    for value in message:
        if isinstance(value, tuple):
            numbers += (n for part in value for n in part) if isinstance(value[0], tuple) else value
        else:
            numbers.append(value)
    if isinstance(message, State):
        numbers.append(0)
    head = (b"LRLK", 1, 0, 5, 0, 0, 0, 0, HEADER.session, HEADER.sequence, 0, HEADER.sent_ns)
    data = layout.pack(*head, *numbers)
    crc32(data)
    crc32(data)
    return layout.unpack(data)


@pytest.mark.bench
@pytest.mark.parametrize("message", [REFERENCE, STATE], ids=["reference", "state"])
@pytest.mark.parametrize(
    "peer", [through_ours, through_json, through_bare_struct], ids=lambda peer: peer.__name__
)
def test_encode_and_decode(
    benchmark: BenchmarkFixture, message: Message, peer: Callable[[Message], Any]
) -> None:
    benchmark.group = f"encode + decode of one {type(message).__name__}"
    result = benchmark(peer, message)
    if peer is through_ours:
        assert result == message
    else:
        assert result
