"""The generated table of docs/calibration.md; ``python -m tools.programs_page`` writes it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.protocol_page import filled
from tools.tables import table
from vision_pc.application.programs import PROGRAMS

PAGE = Path(__file__).parents[1] / "docs" / "calibration.md"


def sections() -> dict[str, str]:
    """Every generated section by its name."""
    rows = (
        (
            f"`{program.name}`",
            program.title,
            f"`{_where(program.core or program.run)}`",
            ", ".join(need.__name__.replace("_", " ") for need in program.needs),
            program.source,
        )
        for program in PROGRAMS
    )
    return {"programs": table("program | what it does | read | needs | source", rows)}


def _where(function: Callable[..., Any]) -> str:
    """The file of a function under vision_pc, and its name."""
    return f"{function.__module__.removeprefix('vision_pc.').replace('.', '/')}.py: {function.__qualname__}"


def rendered(text: str) -> str:
    """``text`` with the table made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    PAGE.write_text(rendered(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
