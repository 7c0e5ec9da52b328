"""The tables of docs/targets.md and docs/markers.md, made from the rows under docs/results;
``python -m tools.sight_pages``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Finished
from testbed.campaigns.typed_rows import typed
from testbed.experiments.markers.limits import HEADS, MARKER_LIMITS, by_value, line, summary
from testbed.experiments.markers.one_picture import AXES, PEERS, WORDS, LimitRow
from testbed.experiments.targets.hole_drives import HOLE_DRIVES
from testbed.experiments.targets.one_look import TargetSceneSettings, target_verdict
from testbed.experiments.targets.one_target import ROWS, TargetRow
from tools.evidence_page import RESULTS, ROOT, Kept, every_kept, headed, verdict_lines
from tools.hole_drive_tables import drive_tables
from tools.protocol_page import filled
from tools.tables import table

PAGES = (ROOT / "docs" / "targets.md", ROOT / "docs" / "markers.md")
_REQUEST = CampaignRequest(ROOT / "configs", RESULTS)
_HEADS = (
    "row | scenes | told | holes found | across mm, camera known: median, 95 % | along mm, as seen | normal °"
)
_HEADS += " | error² / variance told | along | camera known | CPU ms | limits met"


def sections(results: Path = RESULTS) -> dict[str, str]:
    """Every generated section by its name."""
    kept = every_kept(results)
    scenes = [one for one in kept if one.experiment == "targets" and not one.superseded]
    drives = [one for one in kept if one.experiment == HOLE_DRIVES.name]
    limits = [one for one in kept if one.experiment == MARKER_LIMITS.name]
    told = "figure | found | asked | met"
    return {
        "target scenes": "\n\n".join([*(headed(one, _scenes(one)) for one in scenes), *_earlier(kept)]),
        "hole drives": drive_tables(drives),
        "marker limits": "\n\n".join(headed(one, _limits(one)) for one in limits),
        "marker verdict": "\n\n".join(headed(one, table(told, verdict_lines(one))) for one in limits),
    }


def _earlier(kept: Sequence[Kept]) -> list[str]:
    """The rows of scenes that no longer count, as a paragraph; nothing where there are none."""
    told = [
        f"`{one.command}`, commit `{one.commit}`, `docs/results/{one.name}`: {one.superseded}."
        for one in kept
        if one.experiment == "targets" and one.superseded
    ]
    return [f"No longer counted: {' '.join(told)}"] if told else []


def _scenes(one: Kept) -> str:
    rows = [typed(TargetRow, row) for row in one.rows]
    lines = []
    for name, asked in ROWS.items():
        of = [row for row in rows if row.row == name]
        if of:
            refusing = asked.kind in ("bare", "repetitive")
            lines.append([asked.words, len(of), *(_refusals(of) if refusing else _errors(of)), _met(of)])
    false = sum(row.false or 0 for row in rows if row.visible)
    pictures = sum(1 for row in rows if row.visible)
    return table(_HEADS, lines) + f"\n\nFalse holes: {false} in {pictures} pictures."


def _refusals(rows: Sequence[TargetRow]) -> list[str]:
    told = sum(not row.refused for row in rows)
    return [f"{told}, wrong: {sum(row.wrong for row in rows)}", *[""] * 8]


def _errors(rows: Sequence[TargetRow]) -> list[str]:
    told = sum(not row.refused for row in rows)
    visible, found = sum(row.visible or 0 for row in rows), sum(row.found or 0 for row in rows)

    def pair(which: str, field: str) -> str:
        sizes = np.abs(_column(rows, which, field))
        return f"{np.median(sizes):.2f}, {np.percentile(sizes, 95):.2f}"

    return [
        str(told),
        f"{found} of {visible}" if visible else "",
        pair("known", "lateral_mm"),
        pair("seen", "depth_mm"),
        pair("seen", "normal_deg"),
        *(
            f"{_column(rows, which, field).mean():.2f}"
            for which, field in (("seen", "nees"), ("seen", "nees_depth"), ("known", "nees"))
        ),
        f"{np.median([row.measure_ms for row in rows]):.0f}",
    ]


def _column(rows: Sequence[TargetRow], which: str, field: str) -> Any:
    values = np.array([getattr(getattr(row, which), field) for row in rows])
    return values[np.isfinite(values)]


def _met(rows: list[TargetRow]) -> str:
    checks = target_verdict(Finished(_REQUEST, TargetSceneSettings(), (), rows, len(rows)))
    judged = [check.met for check in checks if check.met is not None]
    return f"{sum(judged)} of {len(judged)}"


def _limits(one: Kept) -> str:
    """A table an axis, and one of false markers and time."""
    rows = [typed(LimitRow, row) for row in one.rows]
    values = {WORDS[axis]: by_value(rows, axis) for axis in AXES}
    made = [
        table(" | ".join((words, *HEADS)), (line(*found) for found in of))
        for words, of in values.items()
        if of
    ]
    return "\n\n".join([*made, table(" | ".join(("what", "ours", *PEERS)), summary(rows))])


def rendered(text: str) -> str:
    """``text`` with the tables made anew."""
    return filled(text, sections())


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(rendered(page.read_text(encoding="utf-8")), encoding="utf-8")
