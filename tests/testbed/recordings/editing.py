"""Recordings with something changed in them."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from mcap.records import Message

from foundation.recording.contents import contents
from foundation.recording.decoding import messages, walk
from foundation.recording.mcap_file import McapFile

Change = Callable[[str, int, bytes], bytes | None]


def edited(source: Path, target: Path, change: Change, session: dict[str, str] | None = None) -> Path:
    """``source`` with each message as ``change(topic, how many before it, data)`` has it; None: without."""
    found = contents(source)
    numbers = {channel: number for number, channel in enumerate(found.topics)}
    metadata = {**found.metadata, "session": {**found.metadata["session"], **(session or {})}}
    counts = dict.fromkeys(found.topics, 0)
    with (
        closing(McapFile(target, list(found.topics.values()), metadata)) as file,
        source.open("rb") as stream,
    ):
        for record in walk(stream):
            if isinstance(record, Message):
                channel = record.channel_id
                data = change(found.topics[channel].name, counts[channel], record.data)
                counts[channel] += 1
                if data is not None:
                    file.add(numbers[channel], data, record.log_time, record.publish_time)
    return target


def kept(topic: str, count: int, data: bytes) -> bytes:
    """The message as it is."""
    return data


def all_of(path: Path, topic: str, message: Any) -> list[Any]:
    """Every message of a topic."""
    return [message.FromString(record.data) for _, record in messages(path, {topic})]
