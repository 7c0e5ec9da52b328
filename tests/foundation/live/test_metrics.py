"""Figures as Prometheus' own parser reads them: one name a figure, units in the names, nothing made up."""

import re

import pytest
from prometheus_client.parser import text_string_to_metric_families

from controller.shell.controller_metrics import METRICS as OF_CONTROLLER
from foundation.live.wire import Series, Spread, exposition
from foundation.periods import DurationHistogram
from plant_emulator.shell.plant_metrics import METRICS as OF_PLANT
from vision_pc.shell.rest.metrics import METRICS as OF_VISION

TABLE = (
    Series("memory_mb", "memory_bytes", "Memory.", 1e6),
    Series("link.received", "received_total", "Datagrams."),
    Series("refused", "refused_total", "Refusals.", label="cause"),
    Series("connected", "connected", "1: it is."),
    Series("age_ms", "age_seconds", "Age.", 1e-3),
    Series("scheduling", "scheduling", "A word."),
)


def samples(text: str) -> dict[str, float]:
    """Samples by name and labels."""
    return {
        sample.name + "".join(f"|{key}={value}" for key, value in sample.labels.items()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_every_figure_that_is_known_has_its_sample_in_base_units() -> None:
    figures = {
        "memory_mb": 71.25,
        "link": {"received": 10, "unlisted": 3},
        "refused": {"refused.no_token": 2, 'odd "\\\n': 1},
        "connected": True,
        "age_ms": None,
        "scheduling": "fifo",
    }
    assert samples(exposition("x", TABLE, figures)) == {
        "longreach_x_memory_bytes": 71.25e6,
        "longreach_x_received_total": 10,
        "longreach_x_refused_total|cause=refused.no_token": 2,
        'longreach_x_refused_total|cause=odd "\\\n': 1,
        "longreach_x_connected": 1,
    }
    assert samples(exposition("x", TABLE, {})) == {}


def test_durations_are_a_histogram() -> None:
    durations = DurationHistogram()
    for duration_ns in (40_000, 150_000, 150_000, 70_000_000):
        durations.add(duration_ns)
    found = samples(exposition("x", (), {}, (Spread("late_seconds", "Late.", durations),)))
    assert found["longreach_x_late_seconds_bucket|le=5e-05"] == 1
    assert found["longreach_x_late_seconds_bucket|le=0.0001"] == 1
    assert found["longreach_x_late_seconds_bucket|le=0.0002"] == 3
    assert found["longreach_x_late_seconds_bucket|le=0.05"] == 3
    assert found["longreach_x_late_seconds_bucket|le=+Inf"] == 4
    assert found["longreach_x_late_seconds_count"] == 4
    assert found["longreach_x_late_seconds_sum"] == pytest.approx(0.07034)


@pytest.mark.parametrize("table", [OF_CONTROLLER, OF_PLANT, OF_VISION])
def test_every_name_is_there_once_and_has_a_unit_of_prometheus(table: tuple[Series, ...]) -> None:
    names = [figure.name for figure in table]
    assert len(names) == len(set(names))
    assert len({figure.path for figure in table}) == len(table)
    for figure in table:
        assert re.fullmatch(r"[a-z][a-z0-9_]*", figure.name)
        assert not re.search(r"_(ms|us|ns|mb|m|bar|hz|degc|percent)(_|$)", figure.name), figure.name
        assert figure.help.endswith("."), figure.name
