"""A viewer for tests: the protocol as its specification has it, with nothing of ours but the port."""

import asyncio
import base64
import json
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.asyncio.client import ClientConnection, connect

WITHIN_S = 60.0


class Shown(NamedTuple):
    """One message as a viewer has it."""

    topic: str
    log_ns: int
    message: Any


class Watching:
    """A viewer that is connected. ``channels`` by topic, ``statuses``, ``shown`` in the order of arrival."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.statuses: list[str] = []
        self.shown: list[Shown] = []
        self._classes: dict[int, tuple[str, Any]] = {}

    async def until(self, done: Callable[["Watching"], bool]) -> None:
        """Read until ``done``."""
        async with asyncio.timeout(WITHIN_S):
            while not done(self):
                self._take(await self.connection.recv())

    async def subscribe(self, *topics: str) -> None:
        """Ask for topics."""
        expected = [
            {"id": self.channels[each]["id"] + 100, "channelId": self.channels[each]["id"]} for each in topics
        ]
        await self.connection.send(json.dumps({"op": "subscribe", "subscriptions": expected}))

    async def unsubscribe(self, topic: str) -> None:
        """Ask no longer for a topic."""
        gone = [self.channels[topic]["id"] + 100]
        await self.connection.send(json.dumps({"op": "unsubscribe", "subscriptionIds": gone}))

    def _take(self, said: str | bytes) -> None:
        if isinstance(said, bytes):
            opcode, number, log_ns = struct.unpack_from("<BIQ", said)
            assert opcode == 1
            topic, made = self._classes[number - 100]
            self.shown.append(Shown(topic, log_ns, made.FromString(said[13:])))
            return
        document = json.loads(said)
        match document["op"]:
            case "serverInfo":
                self.info = document
            case "advertise":
                for channel in document["channels"]:
                    self.channels[channel["topic"]] = channel
                    self._classes[channel["id"]] = channel["topic"], _class_of(channel)
            case "unadvertise":
                gone = set(document["channelIds"])
                self.channels = {name: each for name, each in self.channels.items() if each["id"] not in gone}
            case "status":
                self.statuses.append(document["message"])


def _class_of(channel: dict[str, Any]) -> Any:
    assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


@asynccontextmanager
async def watching(port: int, subprotocol: str = "foxglove.sdk.v1", **more: Any) -> AsyncIterator[Watching]:
    """A viewer of the face at ``port``, which has introduced itself."""
    async with connect(
        f"ws://127.0.0.1:{port}/", subprotocols=[subprotocol], max_size=None, **more
    ) as connection:  # type: ignore[list-item]
        assert connection.subprotocol == subprotocol
        viewer = Watching(connection)
        await viewer.until(lambda each: bool(each.info))
        yield viewer
