"""docs/against_reality.md shows what the emulator does now; a late valve is told to be late."""

import pytest

from tools.against_reality_page import PAGE, of_parts, stepped

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_shows_what_is_measured_now() -> None:
    for row in of_parts():
        assert f"| {row.ours} | {row.verdict} |" in TEXT, "run: python -m tools.against_reality_page"


def test_a_later_valve_makes_a_later_joint_by_as_much() -> None:
    late = stepped(0, 0.4, "plant.valves.delay_ms=50.0").delay_s - stepped(0, 0.4).delay_s
    assert late == pytest.approx(0.049, abs=0.003)
