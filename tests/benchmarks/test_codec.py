"""Cost of one reference and one state, encode + decode, against two peers that others would reach for.

``json``: the same header and fields as a JSON object, unchecked. ``bare struct``: one hand-written
``struct`` format and a CRC, no ranges, no named fields, no typed refusals: the floor for pure Python.

And a reference, unsigned and signed, against pymavlink's messages of like size.
Signed, both sides also check the tag and look for a replay.
"""

import statistics
import time
from typing import Any

import pytest

from protocol.authentication import LinkKey, fault_of
from protocol.channel import EXTENDED_MODULUS, SEQUENCE_MODULUS, Arrival, SequenceWindow
from protocol.datagram import decode, encode
from protocol.reference_messages import Message, ReferencePose
from tools.sample_messages import HEADER, MESSAGES

BATCHES, EXCHANGES_A_BATCH = 60, 200

REFERENCE = next(m for m in MESSAGES if isinstance(m, ReferencePose))


class OurLink:
    """Both ends of one direction of the reference link, down to the sequence window."""

    def __init__(self, *, signed: bool) -> None:
        key = LinkKey(bytes(range(32))).of_client(1, 2, 3).sends if signed else None
        self._sends = self._receives = key
        self._sequence = 2**20
        self._window = SequenceWindow(self._sequence, EXTENDED_MODULUS if signed else SEQUENCE_MODULUS)

    def exchange(self, message: Message) -> Message:
        """``message`` as the receiver decoded it, its tag and number found right."""
        self._sequence += 1
        data = encode(message, HEADER._replace(sequence=self._sequence), self._sends)
        header, decoded = decode(data)
        assert fault_of(data, header.flags, self._receives) is None
        assert self._window.arrive(header.sequence)[0] is Arrival.NEW
        return decoded

    def size(self, message: Message) -> int:
        """Bytes on the wire."""
        return len(encode(message, HEADER, self._sends))


@pytest.mark.bench
def test_a_reference_beside_mavlink(capsys: pytest.CaptureFixture[str]) -> None:
    """Encode + decode, batches of all in turn, so that a busy machine is busy for all; prints the table."""
    mavlink = pytest.importorskip("tests.protocol.mavlink_peer", reason="pymavlink is not installed")
    rows: list[tuple[str, str, bool, Any, Any]] = []
    for signed in (False, True):
        rows.append(("Longreach", "REFERENCE_POSE", signed, OurLink(signed=signed), REFERENCE))
        for message in (mavlink.target_message(), mavlink.pose_message()):
            link = mavlink.Link(signed=signed)
            rows.append(("pymavlink", message.get_type(), signed, link, message))
    times: list[list[float]] = [[] for _ in rows]
    for _ in range(BATCHES):
        for row, taken in zip(rows, times, strict=True):
            link, message = row[3], row[4]
            begin = time.perf_counter()
            for _ in range(EXCHANGES_A_BATCH):
                link.exchange(message)
            taken.append((time.perf_counter() - begin) / EXCHANGES_A_BATCH)
    medians = [statistics.median(taken) for taken in times]
    with capsys.disabled():
        crc = "a CRC in Rust" if mavlink.FAST_CRC else "a CRC in Python"
        print(f"\nencode + decode of one reference, median of {BATCHES} batches; pymavlink with {crc}")
        print(f"{'who':10} {'message':30} {'signed':7} {'bytes':>5} {'µs':>7} {'least µs':>9}")
        for (who, name, signed, link, message), median, taken in zip(rows, medians, times, strict=True):
            size = link.size(message)
            line = f"{who:10} {name:30} {'yes' if signed else 'no':7} {size:5} {1e6 * median:7.1f}"
            print(f"{line} {1e6 * min(taken):9.1f}")
        added = 1e6 * (medians[3] - medians[0])
        print(f"signing adds {added:.1f} µs here, {1e6 * (medians[4] - medians[1]):.1f} µs there")
    # Of the least: what a busy machine adds to the others is not the codecs'.
    for ours, peers in ((0, (1, 2)), (3, (4, 5))):
        assert all(min(times[ours]) < min(times[peer]) for peer in peers)
