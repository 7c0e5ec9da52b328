"""A viewer of the services' live face (docs/live.md): it asks for topics and gets their messages; no ROS."""

import base64
import json
import struct
import time
from collections.abc import AsyncIterator, Collection
from typing import Any, NamedTuple

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidURI
from websockets.typing import Subprotocol

from foundation.recording.decoding import class_in
from foundation.recording.mcap_file import Format
from protocol.errors import ConfigurationError, LinkLost

_SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
_HEAD = struct.Struct("<BIQ")
_MESSAGE_DATA = 1
_APART_NS = 1_000_000_000  # so far from our monotonic clock the face goes by another: the plant's


class LiveMessage(NamedTuple):
    """One message: its topic, when its service logged it by our monotonic clock, and what it says.

    By the plant's clock that is a second off at most: it is set anew where it has fallen behind.
    """

    topic: str
    log_ns: int
    message: Any


async def live_messages(url: str, topics: Collection[str]) -> AsyncIterator[LiveMessage]:
    """The messages of ``topics``, as services come and go, over one connection.

    Raises ConfigurationError for an address that is none, LinkLost (``link.no_live_face``) when nobody
    answers or the face ends.
    """
    try:
        async with connect(url, subprotocols=[_SUBPROTOCOL], max_size=None) as connection:
            async for one in _read(connection, topics):
                yield one
        raise LinkLost("link.no_live_face", f"live face at {url}: it has ended")
    except InvalidURI as error:
        raise ConfigurationError("configuration.bad_value", f"--watch {url!r}: {error}") from error
    except (OSError, ConnectionClosed) as error:
        raise LinkLost("link.no_live_face", f"live face at {url}: {error}") from error


async def _read(connection: ClientConnection, topics: Collection[str]) -> AsyncIterator[LiveMessage]:
    known: dict[int, tuple[str, Any]] = {}
    behind_ns = 0
    async for frame in connection:
        if isinstance(frame, bytes):
            opcode, number, log_ns = _HEAD.unpack_from(frame)
            if opcode == _MESSAGE_DATA and number in known:
                topic, made = known[number]
                off_ns = time.monotonic_ns() - log_ns - behind_ns
                if abs(off_ns) > _APART_NS and "calibration" not in topic:  # these are told to who comes late
                    behind_ns += off_ns
                yield LiveMessage(topic, log_ns + behind_ns, made.FromString(frame[_HEAD.size :]))
            continue
        document = json.loads(frame)
        if document["op"] == "advertise":
            new = [channel for channel in document["channels"] if channel["topic"] in topics]
            known |= {channel["id"]: (channel["topic"], _class_of(channel)) for channel in new}
            subscriptions = [{"id": channel["id"], "channelId": channel["id"]} for channel in new]
            await connection.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))


def _class_of(channel: dict[str, Any]) -> Any:
    return class_in(
        Format(channel["schemaName"], "protobuf", base64.b64decode(channel["schema"]), "protobuf")
    )
