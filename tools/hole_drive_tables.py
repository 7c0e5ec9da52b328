"""The tables of drives to holes on docs/targets.md: all machines of a kind together, then every campaign."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from testbed.campaigns.campaign import CampaignRequest
from testbed.campaigns.experiment import Check, Finished
from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.corrected_figures import quantile
from testbed.experiments.positioning.worlds import WorldName
from testbed.experiments.targets.hole_drives import (
    HoleDriveRow,
    HoleDriveSettings,
    HoleEnd,
    hole_drive_verdict,
)
from tools.evidence_page import Kept
from tools.tables import table

_ARMS = {"plant": "4 m arm", "plant_long_crane": "10 m crane"}
_TOGETHER = (
    "machines | what | driven to | share within 5 mm | median, 95 %, worst mm | s a hole | asked | met"
)
_EACH = "command | commit, rows | runs | driven to | within 5 mm | median, 95 %, worst mm | not driven to"
_MET = {True: "yes", False: "NO"}


def drive_tables(kept: Sequence[Kept]) -> str:
    """All current campaigns together, each of them, and those that were superseded with the reason."""
    current = [one for one in kept if not one.superseded]
    kinds = dict.fromkeys(map(_kind, current))
    together = [
        line
        for kind in kinds
        for line in _lines([row for one in current if _kind(one) == kind for row in _rows(one)], kind)
    ]
    parts = [table(_TOGETHER, together), table(_EACH, map(_campaign, current))]
    earlier = [[*_campaign(one), one.superseded] for one in kept if one.superseded]
    if earlier:
        parts += ["Before what was changed since; not counted above:", table(f"{_EACH} | since", earlier)]
    return "\n\n".join(parts)


def _kind(one: Kept) -> tuple[str, str, int, bool]:
    """World, arm, holes a run, whether the tool's marker was covered: what may be counted together."""
    row = _rows(one)[0]
    return row.world, row.arm, int(row.holes), "--bare-tool" in one.command


def _rows(one: Kept) -> list[HoleDriveRow]:
    return [typed(HoleDriveRow, row) for row in one.rows]


def _lines(rows: list[HoleDriveRow], kind: tuple[str, str, int, bool]) -> list[list[str]]:
    """Of the first hole of each run, and of all where there are more."""
    world, arm, holes, bare = kind
    done = Finished(
        CampaignRequest(Path(), Path()), HoleDriveSettings(WorldName(world), holes=holes), (), rows, 0
    )
    checks = [check for check in hole_drive_verdict(done) if "share" in check.what]
    about = f"`{world}`, {_ARMS.get(arm, arm)}"
    covered = ", marker covered after one look" if bare else ""
    every = [(f"one look, the first hole{covered}", [row.ends[:1] or [HoleEnd()] for row in rows])]
    if holes > 1:
        every.append((f"visit of {holes} holes", [row.ends or [HoleEnd()] * holes for row in rows]))
    return [
        _line(about, what, [end for of in ends for end in of], check)
        for (what, ends), check in zip(every, checks, strict=True)
    ]


def _line(about: str, what: str, ends: Sequence[HoleEnd], check: Check) -> list[str]:
    met = _MET.get(check.met, "") if check.met is not None else "too few to say" if check.asked else ""
    seconds = quantile(np.array([end.seconds for end in ends]), 50)
    return [about, what, str(len(ends)), check.found, _spread(ends), f"{seconds:.0f}", check.asked, met]


def _spread(ends: Iterable[HoleEnd]) -> str:
    worst = np.array([end.worst_mm for end in ends])
    return ", ".join(f"{quantile(worst, percent):.2f}" for percent in (50, 95, 100))


def _campaign(one: Kept) -> list[str]:
    rows = _rows(one)
    ends = [end for row in rows for end in row.ends or [HoleEnd()]]
    driven = [end for end in ends if np.isfinite(end.worst_mm)]
    inside = sum(end.worst_mm <= 5.0 for end in driven)
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
