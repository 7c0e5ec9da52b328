"""What a service and its live face say to each other over a local socket.

The service sends frames of a kind, a topic's number, a time and data; the face sends lines of JSON.
"""

import base64
import json
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from foundation.live.foxglove import ShownChannel
from foundation.recording.mcap_file import Topic

HEAD = struct.Struct("<BIQI")
HELLO, MESSAGE, FIGURES = range(3)
MOST = 1 << 26  # bytes of a frame: a raw picture has 2.8 million
SHARED_VARIABLE = "LONGREACH_LIVE"  # the face that several services share, by its abstract socket


class FeedHello(NamedTuple):
    """Who feeds. Of a channel ``id`` is the topic's number, ``once`` holds those that are sent once."""

    service: str
    session: str
    channels: tuple[ShownChannel, ...]
    once: frozenset[int]


def frame(kind: int, data: bytes, topic: int = 0, log_ns: int = 0) -> bytes:
    """One frame."""
    return HEAD.pack(kind, topic, log_ns, len(data)) + data


def hello(service: str, session: str, topics: Sequence[Topic]) -> bytes:
    """The first frame of a service."""
    described = [
        {
            "topic": topic.name,
            "encoding": topic.format.message_encoding,
            "schema_name": topic.format.schema,
            "schema_encoding": topic.format.schema_encoding,
            "schema": base64.b64encode(topic.format.data).decode("ascii"),
        }
        for topic in topics
    ]
    once = [number for number, topic in enumerate(topics) if topic.once]
    said = {"service": service, "session": session, "topics": described, "once": once}
    return frame(HELLO, json.dumps(said).encode())


def read_hello(data: bytes) -> FeedHello:
    """What ``hello`` said."""
    said: dict[str, Any] = json.loads(data)
    channels = []
    for number, each in enumerate(said["topics"]):
        schema = base64.b64decode(each.pop("schema"))
        channels.append(ShownChannel(id=number, schema=schema, **each))
    return FeedHello(said["service"], said["session"], tuple(channels), frozenset(said["once"]))
