"""A service's own figures in Prometheus' text format: a table says what each is called and what it means."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

from foundation.periods import DurationHistogram

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
# [D] Around what is allowed of a scan and of a step of the plant: 1 to 5 ms.
_BOUNDS_US = (50, 100, 200, 500, 1000, 2000, 3000, 5000, 10_000, 20_000, 50_000)


class Figure(NamedTuple):
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


def counters(path: str, name: str, keys: Iterable[str], text: str) -> tuple[Figure, ...]:
    """A counter for each of ``keys`` below ``path``, ``text`` with the key in it for ``{}``."""
    return tuple(
        Figure(f"{path}.{key}", f"{name}_{key}_total", text.format(key.replace("_", " "))) for key in keys
    )


def exposition(
    service: str, table: Sequence[Figure], figures: Mapping[str, Any], spreads: Sequence[Spread] = ()
) -> str:
    """Every figure of ``table`` that ``figures`` have, as ``longreach_SERVICE_NAME``.

    What is absent, or a word, has no sample: a figure that is not known is not zero.
    """
    registry = CollectorRegistry()
    prefix = f"longreach_{service}"
    registry.register(_Collected([*_told(prefix, table, figures), *_spread(prefix, spreads)]))
    return generate_latest(registry).decode()


def value_at(figures: Mapping[str, Any], path: str) -> Any:
    """What stands at ``path`` in nested tables; None where nothing does."""
    found: Any = figures
    for part in path.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


class _Collected:
    def __init__(self, families: list[Metric]) -> None:
        self._families = families

    def collect(self) -> list[Metric]:
        """What was collected."""
        return self._families


def _told(prefix: str, table: Sequence[Figure], figures: Mapping[str, Any]) -> Iterator[Metric]:
    for figure in table:
        value = value_at(figures, figure.path)
        kind = CounterMetricFamily if figure.name.endswith("_total") else GaugeMetricFamily
        family = kind(f"{prefix}_{figure.name}", figure.help, labels=[figure.label] if figure.label else [])
        if figure.label and isinstance(value, Mapping):
            for key, item in value.items():
                family.add_metric([str(key)], figure.scale * item)
        elif isinstance(value, int | float):
            family.add_metric([], figure.scale * value)
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
