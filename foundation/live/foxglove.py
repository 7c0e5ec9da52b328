"""The part of Foxglove's WebSocket protocol that shows and never commands; github.com/foxglove/ws-protocol.

Both subprotocols are alike in it. All messages of a server to a viewer are text, but for the data.
"""

import base64
import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
_DATA = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_WARNING = 1


class ShownChannel(NamedTuple):
    """A topic as viewers know it. ``schema``: the text of its schema."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


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
