"""The generated tables of docs/worlds.md; ``python -m tools.worlds_page`` writes them."""

from pathlib import Path

from laboratory.experiments.positioning.worlds import WORLDS
from tools.protocol_page import filled
from tools.tables import table

PAGE = Path(__file__).parents[1] / "docs" / "worlds.md"


def sections() -> dict[str, str]:
    """Every generated section by its name."""
    worlds = (
        (f"`{name}`", f"`{world.arm}`", ", ".join(_words(axis.name) for axis in world.axes) or "nothing more")
        for name, world in WORLDS.items()
    )
    axes = {axis.name: axis for world in WORLDS.values() for axis in world.axes}
    drawn = ((_words(axis.name), axis.width, axis.source) for axis in axes.values())
    return {
        "worlds": table("world | arm | drawn beside the task and the lab's own", worlds),
        "axes": table("axis | how wide | why so wide", drawn),
    }


def _words(name: str) -> str:
    return name.replace("_", " ")


def rendered(text: str) -> str:
    """``text`` with the tables made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
