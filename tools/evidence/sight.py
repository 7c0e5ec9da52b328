"""What campaigns of targets, drives to holes and markers show, for docs/targets.md and docs/markers.md."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Finished
from testbed.campaigns.typed_rows import typed
from testbed.experiments.markers.limits import HEADS, MARKER_LIMITS, by_value, line, summary
from testbed.experiments.markers.one_picture import AXES, PEERS, WORDS, LimitRow
from testbed.experiments.positioning.corrected_figures import LIMIT_MM, quantile
from testbed.experiments.positioning.worlds import WorldName
from testbed.experiments.targets.hole_drives import (
    HOLE_DRIVES,
    HoleDriveRow,
    HoleDriveSettings,
    HoleEnd,
    hole_drive_verdict,
)
from testbed.experiments.targets.one_look import TargetSceneSettings, target_verdict
from testbed.experiments.targets.one_target import ROWS, TargetRow
from tools.evidence.campaigns import verdict_lines
from tools.evidence.kept_rows import MET, RESULTS, ROOT, Kept, headed
from tools.tables import table

_REQUEST = CampaignRequest(ROOT / "configs", RESULTS)
_HEADS = (
    "row | scenes | told | holes found | across mm, camera known: median, 95 % | along mm, as seen | normal °"
)
_HEADS += " | error² / variance told | along | camera known | CPU ms | limits met | rows"
_ARMS = {"plant": "4 m arm", "plant_long_crane": "10 m crane"}
_TOGETHER = (
    "machines | what | driven to | share within 5 mm | median, 95 %, worst mm | s a hole | asked | met"
)
_EACH = "command | commit, rows | runs | driven to | within 5 mm | median, 95 %, worst mm | not driven to"


def sections(kept: Sequence[Kept]) -> dict[str, str]:
    """Every generated section by its name."""
    scenes = [one for one in kept if one.experiment == "targets"]
    drives = [one for one in kept if one.experiment == HOLE_DRIVES.name]
    limits = [one for one in kept if one.experiment == MARKER_LIMITS.name]
    told = "figure | found | asked | met"
    return {
        "target scenes": _scenes(scenes),
        "hole drives": _drive_tables(drives),
        "marker limits": "\n\n".join(headed(one, _limits(one)) for one in limits),
        "marker verdict": "\n\n".join(headed(one, table(told, verdict_lines(one))) for one in limits),
    }


def _scenes(kept: Sequence[Kept]) -> str:
    """One table of all rows, those of a name together; what was typed for them; false holes of all."""
    typed_in = {one.name: [typed(TargetRow, row) for row in one.rows] for one in kept}
    lines = []
    for name, asked in ROWS.items():
        for campaign, rows in typed_in.items():
            of = [row for row in rows if row.row == name]
            if of:
                refusing = asked.kind in ("bare", "repetitive")
                cells = _refusals(of) if refusing else _errors(of)
                lines.append([asked.words, len(of), *cells, _met(of), campaign.removeprefix("targets-")])
    pictures = [row for rows in typed_in.values() for row in rows if row.visible]
    false = sum(row.false or 0 for row in pictures)
    campaigns = ([f"`docs/results/{one.name}`", f"`{one.command}`", f"`{one.commit}`"] for one in kept)
    parts = [table(_HEADS, lines), f"False holes: {false} in {len(pictures)} pictures."]
    return "\n\n".join([*parts, table("rows | command | commit", campaigns)])


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


def _drive_tables(kept: Sequence[Kept]) -> str:
    """All campaigns of a kind together, then each of them."""
    kinds = dict.fromkeys(map(_kind, kept))
    together = [
        _together([row for one in kept if _kind(one) == kind for row in _rows(one)], kind) for kind in kinds
    ]
    return "\n\n".join([table(_TOGETHER, together), table(_EACH, map(_campaign, kept))])


def _kind(one: Kept) -> tuple[str, str, int, bool]:
    """World, arm, holes a run, whether the tool's marker was covered: what may be counted together."""
    row = _rows(one)[0]
    return row.world, row.arm, int(row.holes), "--bare-tool" in one.command


def _rows(one: Kept) -> list[HoleDriveRow]:
    return [typed(HoleDriveRow, row) for row in one.rows]


def _together(rows: list[HoleDriveRow], kind: tuple[str, str, int, bool]) -> list[str]:
    """One kind's line: of the hole of each run, or of all holes of all visits."""
    world, arm, holes, bare = kind
    done = Finished(_REQUEST, HoleDriveSettings(WorldName(world), holes=holes), (), rows, 0)
    check = [check for check in hole_drive_verdict(done) if "share" in check.what][-1]
    what = "one look, one hole" if holes == 1 else f"visits of {holes} holes"
    ends = [end for row in rows for end in row.ends or [HoleEnd()] * holes]
    met = "too few to say" if check.met is None and check.asked else MET[check.met]
    seconds = quantile(np.array([end.seconds for end in ends]), 50)
    return [
        f"`{world}`, {_ARMS.get(arm, arm)}",
        f"{what}, marker covered after one look" if bare else what,
        str(len(ends)),
        check.found,
        _spread(ends),
        f"{seconds:.0f}",
        check.asked,
        met,
    ]


def _spread(ends: Iterable[HoleEnd]) -> str:
    worst = np.array([end.worst_mm for end in ends])
    return ", ".join(f"{quantile(worst, percent):.2f}" for percent in (50, 95, 100))


def _campaign(one: Kept) -> list[str]:
    rows = _rows(one)
    ends = [end for row in rows for end in row.ends or [HoleEnd()]]
    driven = [end for end in ends if np.isfinite(end.worst_mm)]
    inside = sum(end.worst_mm <= LIMIT_MM for end in driven)
    causes = sorted({end.failure.split(":")[0] for end in ends if end.failure} | _causes(rows))
    return [
        f"`{one.command}`",
        f"`{one.commit}`, `docs/results/{one.name}`",
        str(len(rows)),
        str(len(ends)),
        str(inside),
        _spread(driven),
        f"{len(ends) - len(driven)}: {', '.join(f'`{cause}`' for cause in causes)}" if causes else "",
    ]


def _causes(rows: Iterable[HoleDriveRow]) -> set[str]:
    return {row.failure.split(":")[0] for row in rows if row.failure}
