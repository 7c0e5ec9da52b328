"""The generated tables of docs/worlds.md; ``python -m tools.worlds_page`` writes them."""

from pathlib import Path

from laboratory.experiments.positioning.worlds import WORLDS
from tools.protocol_page import filled
from tools.tables import table

PAGE = Path(__file__).parents[1] / "docs" / "worlds.md"


def sections() -> dict[str, str]:
    """Every generated section by its name."""
    axes = {axis.name: axis for world in WORLDS.values() for axis in world.axes}
    worlds = (
        (f"`{name}`", f"`{world.arm}`", _axes_of([axis.name for axis in world.axes], list(axes)))
        for name, world in WORLDS.items()
    )
    drawn = (f"- **{_words(axis.name)}**: {axis.width}" for axis in axes.values())
    return {
        "worlds": table("world | arm | drawn beside the task and the lab's own", worlds),
        "axes": "\n".join(drawn),
    }


def _axes_of(drawn: list[str], every: list[str]) -> str:
    """What a world draws: its axes, or those that it leaves out, whichever is shorter."""
    left_out = [axis for axis in every if axis not in drawn]
    if not drawn:
        return "nothing more"
    if len(left_out) < len(drawn):
        return f"all axes below but {', '.join(map(_words, left_out))}"
    return ", ".join(map(_words, drawn))


def _words(name: str) -> str:
    return name.replace("_", " ")


def rendered(text: str) -> str:
    """``text`` with the tables made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
