"""The tables of docs/controller.md are those of the code: states and faults."""

import re
from pathlib import Path

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.supervision import FAULTS
from protocol.axes_group import Mode
from protocol.faults import FAULT_TEXTS, Reason, Severity

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _between(mark: str) -> str:
    match = re.search(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->", PAGE, re.DOTALL)
    assert match is not None
    return match.group(1).strip()


def state_table() -> str:
    """The page's table of states, from the transition table."""
    lines = [f"| stimulus | {' | '.join(_words(mode.name) for mode in Mode)} |"]
    lines.append("| --- " * (len(Mode) + 1) + "|")
    for stimulus in Stimulus:
        cells = []
        for mode in Mode:
            after = TRANSITIONS[mode, stimulus]
            reason = "" if after.reason is Reason.ACCEPTED else f" ({_words(after.reason.name)})"
            cells.append(f"{'–' if after.mode is mode else _words(after.mode.name)}{reason}")
        lines.append(f"| {stimulus.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def fault_table() -> str:
    """The page's table of faults, with the words of the written protocol."""
    lines = ["| fault | when | reaction |", "| --- | --- | --- |"]
    for row in FAULTS:
        reaction = "stop" if row.reaction.severity is Severity.STOP else "emergency"
        lines.append(f"| `{row.code.name}` | {FAULT_TEXTS[row.code]} | {reaction} |")
    return "\n".join(lines)


def test_the_table_of_states_is_the_transition_table() -> None:
    assert _between("states") == state_table()


def test_the_table_of_faults_is_the_supervision_s() -> None:
    assert _between("faults") == fault_table()
