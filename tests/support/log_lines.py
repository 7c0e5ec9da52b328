"""Event logs whose lines a test can read, and the schema of a line, as docs/event_log.md has it."""

import io
import json
import re
from typing import Any

from foundation.event_log import LEVELS, MEMBERS, EventLog

_CLOSED_WITHIN_S = 20.0


class HeardLog(EventLog):
    """An event log that writes to memory. Reading it waits for its own thread: nothing written is missed."""

    def __init__(self, service: str = "test", stream: io.StringIO | None = None) -> None:
        """``stream``: what the lines go to; a plain one by default."""
        self.heard = io.StringIO() if stream is None else stream
        super().__init__(service, self.heard)

    def text(self) -> str:
        """All lines written before this call."""
        self.flush()
        return self.heard.getvalue()

    def lines(self, event: str | None = None) -> list[dict[str, Any]]:
        """The same, each as what it says; of ``event`` alone where one is named."""
        lines = [json.loads(line) for line in self.text().splitlines()]
        return [line for line in lines if event in (None, line["event"])]

    def close(self) -> None:
        """As of every log, but wait on a starved machine too until the last line is there."""
        super().close()
        self._thread.join(_CLOSED_WITHIN_S)


def assert_obeys(line: dict[str, Any], service: str) -> None:
    """Assert that ``line`` is one of ``service``."""
    assert tuple(line)[: len(MEMBERS)] == MEMBERS, line
    assert line["service"] == service
    assert re.fullmatch(r"[a-z][a-z0-9_]*", line["event"]), line
    assert line["level"] in LEVELS, line
    assert type(line["time_ns"]) is int, line
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", line["utc"]), line
    if "cause" in line and line["level"] != "info":
        assert line["cause"] is None or re.fullmatch(r"[A-Za-z][A-Za-z0-9_.]*", line["cause"]), line
