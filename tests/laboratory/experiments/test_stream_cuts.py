"""A few cuts of the reference stream; ``longreach experiment robustness`` makes 459."""

import pytest

from laboratory.experiments.robustness.stream_cuts import COMMAND_MS, FLOW_MS, one_cut
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.support.paths import CONFIGS


@pytest.mark.parametrize("seed", [3, 5, 8])
def test_a_cut_stream_is_stopped_in_time_and_for_good(seed: int) -> None:
    row = one_cut(load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", seed, [])), seed)
    assert 0.0 < row["command_ms"] <= COMMAND_MS
    assert 0.0 < row["flow_ms"] <= FLOW_MS
    assert not row["resumed"]
    assert row["fault"] == "REFERENCE_STALE"
    assert row["pass"]


def test_a_controller_that_waits_longer_is_found_out() -> None:
    late = ["controller.streaming.silence_ms=130"]
    row = one_cut(load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", 3, late)), 3)
    assert row["command_ms"] > COMMAND_MS
    assert not row["pass"]
