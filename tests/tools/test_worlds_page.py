"""docs/worlds.md's tables are the worlds that are drawn."""

from testbed.experiments.positioning.worlds import WORLDS
from tools.worlds_page import PAGE, rendered

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_tables_are_those_of_the_code() -> None:
    assert rendered(TEXT) == TEXT, "run: python -m tools.worlds_page"
    assert all(f"| `{name}` |" in TEXT for name in WORLDS)
    assert all(axis.source in TEXT for world in WORLDS.values() for axis in world.axes)
