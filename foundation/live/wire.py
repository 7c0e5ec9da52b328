"""What a service shows live: messages and their viewers' channels, and figures as Prometheus' text."""

import base64
import json
import struct
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, Generic, NamedTuple, TypeVar

from prometheus_client import generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

from foundation.periods import DurationHistogram
from foundation.recording.mcap_file import Topic

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
# [D] Around what is allowed of a scan and of a step of the plant: 1 to 5 ms.
_BOUNDS_US = (50, 100, 200, 500, 1000, 2000, 3000, 5000, 10_000, 20_000, 50_000)


class Series(NamedTuple):
    """One figure: ``path`` leads to it in the service's statistics, ``name`` is told with the base unit of
    Prometheus after it, ``scale`` makes that unit of what the statistics have.

    A name that ends in ``_total`` is a counter, any other a gauge. ``label``: the path leads to a table,
    whose keys become this label.
    """

    path: str
    name: str
    help: str
    scale: float = 1.0
    label: str = ""


class Spread(NamedTuple):
    """Durations, told as a histogram; ``name`` ends in ``_seconds``."""

    name: str
    help: str
    durations: DurationHistogram


def counters(path: str, name: str, keys: Iterable[str], text: str) -> tuple[Series, ...]:
    """A counter for each of ``keys`` below ``path``, ``text`` with the key in it for ``{}``."""
    return tuple(
        Series(f"{path}.{key}", f"{name}_{key}_total", text.format(key.replace("_", " "))) for key in keys
    )


def exposition(
    service: str, table: Sequence[Series], metrics: Mapping[str, Any], spreads: Sequence[Spread] = ()
) -> str:
    """Every figure of ``table`` that ``metrics`` have, as ``longreach_SERVICE_NAME``.

    What is absent, or a word, has no sample: a figure that is not known is not zero.
    """
    prefix = f"longreach_{service}"
    families = [*_metrics_of(prefix, table, metrics), *_spread(prefix, spreads)]
    collected: Any = SimpleNamespace(collect=lambda: families)
    return generate_latest(collected).decode()


def value_at(metrics: Mapping[str, Any], path: str) -> Any:
    """What stands at ``path`` in nested tables; None where nothing does."""
    found: Any = metrics
    for part in path.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def _metrics_of(prefix: str, table: Sequence[Series], metrics: Mapping[str, Any]) -> Iterator[Metric]:
    for series in table:
        value = value_at(metrics, series.path)
        kind = CounterMetricFamily if series.name.endswith("_total") else GaugeMetricFamily
        family = kind(f"{prefix}_{series.name}", series.help, labels=[series.label] if series.label else [])
        if series.label and isinstance(value, Mapping):
            for key, item in value.items():
                family.add_metric([str(key)], series.scale * item)
        elif isinstance(value, int | float):
            family.add_metric([], series.scale * value)
        if family.samples:
            yield family


def _spread(prefix: str, spreads: Sequence[Spread]) -> Iterator[Metric]:
    for name, text, durations in spreads:
        family = HistogramMetricFamily(f"{prefix}_{name}", text)
        below = durations.counts_below_us(_BOUNDS_US)
        bounds = [f"{bound / 1e6:g}" for bound in _BOUNDS_US]
        counts = zip((*bounds, "+Inf"), map(float, below), strict=True)
        family.add_metric([], list(counts), durations.sum_ns / 1e9)
        yield family


HEAD = struct.Struct("<BIQI")
HELLO, MESSAGE, METRICS = range(3)
MOST = 1 << 26  # bytes of a frame: a raw picture has 2.8 million
FEEDS_VARIABLE = "LONGREACH_LIVE"  # the Unix socket through which services feed the live view


def frame(kind: int, data: bytes, topic: int = 0, log_ns: int = 0) -> bytes:
    """One frame."""
    return HEAD.pack(kind, topic, log_ns, len(data)) + data


def hello(service: str, session: str, topics: Sequence[Topic]) -> bytes:
    """The first frame of a service: its channels as viewers know them, but for their numbers."""
    channels = [
        {
            "topic": topic.name,
            "encoding": topic.format.message_encoding,
            "schemaName": topic.format.schema,
            "schemaEncoding": topic.format.schema_encoding,
            "schema": base64.b64encode(topic.format.data).decode("ascii"),
        }
        for topic in topics
    ]
    return frame(HELLO, json.dumps({"service": service, "session": session, "channels": channels}).encode())


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
    document = {"op": "serverInfo", "name": name, "capabilities": [], "metadata": {}, "sessionId": session}
    return json.dumps(document)


def advertise(channels: Iterable[Mapping[str, Any]]) -> str:
    """There are these channels."""
    return json.dumps({"op": "advertise", "channels": list(channels)})


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
    document: Any = json.loads(message)
    if not isinstance(document, dict):
        raise ValueError("not an object")
    try:
        if document.get("op") == "subscribe":
            wanted = document["subscriptions"]
            return Subscriptions({_number(each["id"]): _number(each["channelId"]) for each in wanted}, ())
        if document.get("op") == "unsubscribe":
            return Subscriptions({}, tuple(_number(number) for number in document["subscriptionIds"]))
    except (KeyError, TypeError) as error:
        raise ValueError(f"{document['op']}: {error!r}") from error
    raise ValueError(f"operation {str(document.get('op'))[:40]!r} is not served")


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
        self._waiting: dict[int, deque[T]] = {}
        self._turn = 0

    def put(self, topic: int, item: T, size: int) -> None:
        """Keep ``item`` as the newest of ``topic``, whose items are all of about ``size`` bytes."""
        if topic not in self._waiting:
            self._waiting[topic] = deque(maxlen=max(1, min(MOST_MESSAGES, MOST_BYTES // max(size, 1))))
        waiting = self._waiting[topic]
        self.dropped += len(waiting) == waiting.maxlen
        waiting.append(item)

    def take(self) -> tuple[int, T] | None:
        """Topic and item of the one whose turn it is; None when nothing waits."""
        topics = list(self._waiting)
        for turn in range(self._turn, self._turn + len(topics)):
            topic = topics[turn % len(topics)]
            if self._waiting[topic]:
                self._turn = turn + 1
                return topic, self._waiting[topic].popleft()
        return None
