"""Generated tables of the pages on protocol, coupler, programs and worlds, the list of the suites' cases and
the constants of the program in structured text; ``python -m tools.pages`` writes them.
"""

import csv
import io
import re
from collections.abc import Callable
from typing import Any

from conformance.runner import coupler_cases, reference_cases
from controller.config import ControllerConfig
from controller_st.constants import constants_text
from foundation.configuration import load
from laboratory.experiments.positioning.worlds import WORLDS
from nominal_arm.description import NominalArm
from tools.site import reference
from tools.tables import CONFIGS, ROOT, protocol_sections, table
from vision_pc.application.programs import PROGRAMS

DOCS = ROOT / "docs"
CASES = DOCS / "protocol" / "cases.csv"
PLC_CONSTANTS = ROOT / "plc" / "constants.st"


def program_sections() -> dict[str, str]:
    """The table of the programs."""
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


def world_sections() -> dict[str, str]:
    """The tables of the worlds and their axes."""
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
    """What a world draws."""
    return "all axes below" if len(drawn) == len(every) else ", ".join(map(_words, drawn))


def _words(name: str) -> str:
    return name.replace("_", " ")


PAGES: dict[str, Callable[[], dict[str, str]]] = {
    "protocol.md": protocol_sections,
    "calibration.md": program_sections,
    "worlds.md": world_sections,
}


def _reference(name: str, made: Callable[[], str]) -> Callable[[], dict[str, str]]:
    return lambda: {name: made()}


PAGES |= {
    f"reference/{name}.md": _reference(name, made)
    for name, made in (
        ("configuration", reference.page),
        ("commands", reference.commands_page),
        ("python", reference.python_page),
    )
}


def rendered(page: str) -> str:
    """The text of ``page`` with every generated section made anew."""
    sections = PAGES[page]()
    marked = re.compile(r"(<!-- generated: ([a-z ]+) -->)\n.*?(<!-- end -->)", re.DOTALL)
    text = (DOCS / page).read_text(encoding="utf-8")
    return marked.sub(lambda match: f"{match[1]}\n{sections[match[2]]}\n{match[3]}", text)


def cases_csv() -> str:
    """Every case of both suites: number, clause that it cites, whether it moves or writes, question."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("suite", "case", "clause", "moves", "question"))
    for suite, cases in (("reference", reference_cases()), ("coupler", coupler_cases())):
        writer.writerows((suite, c.number, c.clause, "yes" if c.motion else "", c.title) for c in cases)
    return out.getvalue()


def plc_constants() -> str:
    """``plc/constants.st``, made from the shipped configuration."""
    return constants_text(
        load(NominalArm, CONFIGS / "arm.yaml"), load(ControllerConfig, CONFIGS / "controller.yaml")
    )


if __name__ == "__main__":
    PLC_CONSTANTS.write_text(plc_constants(), encoding="utf-8")
    CASES.write_text(cases_csv(), encoding="utf-8")
    for name in PAGES:
        (DOCS / name).write_text(rendered(name), encoding="utf-8")
