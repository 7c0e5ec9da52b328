"""A recording as tables: one CSV file a topic, a column a number."""

import csv
from pathlib import Path

from mcap.records import Message

from foundation.recording.decoding import decoder, walk
from foundation.recording.recovery import contents

TIMES = ("log_time_ns", "publish_time_ns")


def write_tables(source: Path, directory: Path) -> tuple[dict[str, int], list[str]]:
    """Write ``directory``/TOPIC.csv for every topic of ``source``; return rows by file, and topics left out
    because their encoding is not known.

    What a message does not have is an empty cell. Raises FileExistsError where a file is there.
    """
    found = contents(source)
    directory.mkdir(parents=True, exist_ok=True)
    rows, left_out = {}, []
    for channel, topic in found.topics.items():
        decode = decoder(topic.format)
        if decode is None:
            left_out.append(topic.name)
            continue
        columns: dict[str, None] = {}
        with source.open("rb") as stream:
            for record in walk(stream):
                if isinstance(record, Message) and record.channel_id == channel:
                    columns |= dict.fromkeys(decode(record.data))
        path = directory / f"{topic.name.strip('/').replace('/', '_')}.csv"
        with path.open("x", newline="", encoding="utf-8") as file, source.open("rb") as stream:
            table = csv.DictWriter(file, [*TIMES, *columns])
            table.writeheader()
            for record in walk(stream):
                if isinstance(record, Message) and record.channel_id == channel:
                    times = dict(zip(TIMES, (record.log_time, record.publish_time), strict=True))
                    table.writerow(times | decode(record.data))
        rows[path.name] = found.counts.get(channel, 0)
    return rows, left_out
