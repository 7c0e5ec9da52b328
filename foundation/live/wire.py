"""What the live face says to its feeds and its viewers, and the newest that wait for either."""

import base64
import json
import struct
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from foundation.recording.mcap_file import Topic

HEAD = struct.Struct("<BIQI")
HELLO, MESSAGE, FIGURES = range(3)
MOST = 1 << 26  # bytes of a frame: a raw picture has 2.8 million
SHARED_VARIABLE = "LONGREACH_LIVE"  # the face that several services share, by its abstract socket


class ShownChannel(NamedTuple):
    """A topic as viewers know it. ``schema``: the text of its schema."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


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


SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_DATA = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_WARNING = 1


class Subscriptions(NamedTuple):
    """What a viewer asks for: ``added`` maps its own numbers to channels, ``removed`` are such numbers."""

    added: Mapping[int, int]
    removed: tuple[int, ...]


def server_info(name: str, session: str) -> str:
    """The first message of a server. It has no capabilities: nothing can be set, called or published."""
    said = {"op": "serverInfo", "name": name, "capabilities": [], "metadata": {}, "sessionId": session}
    return json.dumps(said)


def advertise(channels: Iterable[ShownChannel]) -> str:
    """There are these channels."""
    said = [
        {
            "id": channel.id,
            "topic": channel.topic,
            "encoding": channel.encoding,
            "schemaName": channel.schema_name,
            "schemaEncoding": channel.schema_encoding,
            "schema": base64.b64encode(channel.schema).decode("ascii"),
        }
        for channel in channels
    ]
    return json.dumps({"op": "advertise", "channels": said})


def unadvertise(channels: Iterable[int]) -> str:
    """These channels are no more."""
    return json.dumps({"op": "unadvertise", "channelIds": list(channels)})


def warning(text: str) -> str:
    """A status that a viewer shows to its user."""
    return json.dumps({"op": "status", "level": _WARNING, "message": text})


def message_data(subscription: int, log_ns: int, data: bytes) -> bytes:
    """A message of the channel to which the viewer gave the number ``subscription``."""
    return _DATA.pack(_MESSAGE_DATA, subscription, log_ns) + data


def subscriptions(message: str | bytes) -> Subscriptions:
    """What a viewer's message asks for. Raises ValueError for what is none of this server's business."""
    if isinstance(message, bytes):
        raise ValueError("this server takes no data")
    said: Any = json.loads(message)
    if not isinstance(said, dict):
        raise ValueError("not an object")
    try:
        if said.get("op") == "subscribe":
            wanted = said["subscriptions"]
            return Subscriptions({_number(each["id"]): _number(each["channelId"]) for each in wanted}, ())
        if said.get("op") == "unsubscribe":
            return Subscriptions({}, tuple(_number(number) for number in said["subscriptionIds"]))
    except (KeyError, TypeError) as error:
        raise ValueError(f"{said['op']}: {error!r}") from error
    raise ValueError(f"operation {str(said.get('op'))[:40]!r} is not served")


def _number(value: Any) -> int:
    if not isinstance(value, int) or not 0 <= value < 1 << 32:
        raise ValueError(f"{str(value)[:40]!r} is no number of 32 bits")
    return value


T = TypeVar("T")
# [D] A third of a second of the quickest topic; of pictures the newest alone.
MOST_MESSAGES, MOST_BYTES = 16, 1 << 20


class LatestQueue(Generic[T]):
    """Items by topic, taken from the topics in turn. ``dropped``: how many made room for newer ones.

    One thread may put while another takes.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: dict[int, deque[tuple[T, int]]] = {}
        self._turns: deque[int] = deque()

    def put(self, topic: int, item: T, size: int) -> None:
        """Keep ``item``, of ``size`` bytes, as the newest of ``topic``."""
        waiting = self._waiting.setdefault(topic, deque())
        waiting.append((item, size))
        bound = max(1, min(MOST_MESSAGES, MOST_BYTES // max(size, 1)))
        if len(waiting) <= bound:
            self._turns.append(topic)
            return
        while len(waiting) > bound:
            try:
                waiting.popleft()
            except IndexError:  # the taker was quicker
                break
            self.dropped += 1

    def take(self) -> tuple[int, T] | None:
        """Topic and item of the one whose turn it is; None when nothing waits."""
        while self._turns:
            topic = self._turns.popleft()
            try:
                return topic, self._waiting[topic].popleft()[0]
            except IndexError:  # dropped meanwhile
                continue
        return None
