"""The generated tables of docs/worlds.md; ``python -m tools.worlds_page`` writes them."""

import re
from pathlib import Path

from laboratory.experiments.positioning.worlds import WORLDS
from tools.protocol_page import filled
from tools.tables import table

PAGE = Path(__file__).parents[1] / "docs" / "worlds.md"


def sections() -> dict[str, str]:
    """Every generated section by its name."""
    worlds = ((f"`{name}`", f"`{world.arm}`", _axes_of(name)) for name, world in WORLDS.items())
    axes = {axis.name: axis for world in WORLDS.values() for axis in world.axes}
    drawn = ((_words(axis.name), axis.width, _tags(axis.source)) for axis in axes.values())
    return {
        "worlds": table("world | arm | drawn beside the task and the lab's own", worlds),
        "axes": table("axis | how wide | basis", drawn),
    }


def _axes_of(name: str) -> str:
    """What the world draws, or the first world that draws the same."""
    drawn = {world: [axis.name for axis in of.axes] for world, of in WORLDS.items()}
    first = next(world for world, axes in drawn.items() if axes == drawn[name])
    words = ", ".join(_words(axis) for axis in drawn[name]) or "nothing more"
    return words if first == name else f"as `{first}`"


def _tags(source: str) -> str:
    """The kinds of source, such as [S]; the code has them in words."""
    return " ".join(dict.fromkeys(re.findall(r"\[[A-Z]\]", source)))


def _words(name: str) -> str:
    return name.replace("_", " ")


def rendered(text: str) -> str:
    """``text`` with the tables made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
