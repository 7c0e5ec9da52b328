"""The schema of an event log's line, as docs/event_log.md has it, for tests of real and of made lines."""

import re
from typing import Any

from foundation.event_log import LEVELS, MEMBERS


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
