"""The text that Prometheus reads: every number a sample, names and labels as its format wants them."""

import re

from foundation.rest.metrics import exposition

_NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
_LABEL = r'\{[a-zA-Z_][a-zA-Z0-9_]*="(?:[^"\\\n]|\\["\\n])*"\}'
_VALUE = r"(?:[-+]?[0-9.]+(?:e[-+]?[0-9]+)?|NaN|\+Inf|-Inf)"
LINE = re.compile(rf"(?:# TYPE {_NAME} untyped|{_NAME}(?:{_LABEL})? {_VALUE})")


def test_every_number_has_its_sample_and_every_name_its_type_once() -> None:
    figures = {
        "memory_mb": 71.25,
        "link": {"received": 10, "longest_gap": 0},
        "connected": True,
        "scheduling": "fifo",
        "age_ms": None,
        "refused": {"refused.no_token": 2, 'odd "\\\n': 1},
        "worst": float("inf"),
        "tiny": 1e-12,
    }
    text = exposition("vision_pc", figures)
    assert all(LINE.fullmatch(line) for line in text.splitlines())
    assert [line for line in text.splitlines() if not line.startswith("#")] == [
        "longreach_vision_pc_memory_mb 71.25",
        "longreach_vision_pc_link_received 10",
        "longreach_vision_pc_link_longest_gap 0",
        "longreach_vision_pc_connected 1",
        'longreach_vision_pc_refused{cause="refused.no_token"} 2',
        'longreach_vision_pc_refused{cause="odd \\"\\\\\\n"} 1',
        "longreach_vision_pc_worst +Inf",
        "longreach_vision_pc_tiny 1e-12",
    ]
    types = [line for line in text.splitlines() if line.startswith("#")]
    assert len(types) == len(set(types)) == 7
    assert text.endswith("\n")


def test_without_figures_there_is_nothing() -> None:
    assert exposition("vision_pc", {}) == ""
