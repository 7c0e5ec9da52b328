"""What the kept rows of the real worlds say together, whichever campaign they are of.

How looks end with either eyes, how often what was told before moving came true, and whether pictures end as
the eye model does.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from testbed.campaigns.experiment import Check, at_least, at_most
from testbed.campaigns.options import EyesKind
from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.corrected import BRANCHES
from testbed.experiments.positioning.corrected_figures import LIMIT_MM, quantile, share, told, worst_mm
from testbed.experiments.positioning.corrected_run import PositioningRow
from testbed.experiments.positioning.eyes_agree import EYES_AGREE, FACTOR, EyesRow, compare, paired
from testbed.experiments.positioning.told import nees, reliability, silent_misses, told_checks
from testbed.experiments.positioning.worlds import WORLDS, WorldName
from tools.evidence.kept_rows import MET, Kept
from tools.tables import table

MACHINES = {WorldName.REAL: "4 m arm", WorldName.CRANE_REAL: "10 m crane"}
_EYES = {EyesKind.MODEL: "model", EyesKind.PIXELS: "pictures"}
_LOOKS = {"look1": "one look", "look2": "two looks"}
_LEAST_RUNS = {EyesKind.MODEL: 200, EyesKind.PIXELS: 60}  # an arm; of pictures over both
_ENDS = "machine | eyes | after | runs | within 5 mm | median, 95 %, worst mm | stopped"
_ENDS += " | error² / variance told | silent misses | asked | met"
_RATIOS = "machine | after | pairs | stopped with one | pictures over model, 90 % | seen from | asked | met"
_PROBABILITIES = "machine | P told | looks | mean told | ended within 5 mm"


class MachineRun(NamedTuple):
    """A run, and as what it is compared with the same seed's other eyes."""

    world: WorldName
    eyes: EyesKind
    run: PositioningRow
    seen: EyesRow | None


def counts(one: Kept) -> bool:
    """Whether a campaign is of the real worlds and of looks, with either eyes or both."""
    return one.experiment in ("best-mode", EYES_AGREE.name) and one.rows[0]["world"] in MACHINES


def sections(kept: Iterable[Kept]) -> dict[str, str]:
    """Every generated section by its name."""
    found = rows(kept)
    return {
        "real machines": table(_ENDS, _ends(found)),
        "pictures and model": table(_RATIOS, _ratios([row.seen for row in found if row.seen])),
        "told probabilities": table(_PROBABILITIES, _probabilities(found)),
    }


def rows(kept: Iterable[Kept]) -> list[MachineRun]:
    """The runs of all campaigns that count here."""
    return [_row(one, row) for one in kept if counts(one) for row in one.rows]


def _row(one: Kept, row: dict[str, Any]) -> MachineRun:
    seen = typed(EyesRow, row) if one.experiment == EYES_AGREE.name else None
    eyes = EyesKind(seen.eyes) if seen else EyesKind.MODEL
    return MachineRun(WorldName(row["world"]), eyes, typed(PositioningRow, row), seen)


def _ends(rows: Sequence[MachineRun]) -> Iterable[Sequence[str]]:
    """A line for each machine, eyes and look that has rows."""
    pictures = sum(row.eyes == EyesKind.PIXELS for row in rows)
    for world, machine in MACHINES.items():
        for eyes, seen_by in _EYES.items():
            runs = [row.run for row in rows if (row.world, row.eyes) == (world, eyes)]
            for look, after in _LOOKS.items() if runs else ():
                counted = pictures if eyes == EyesKind.PIXELS else len(runs)
                met = "too few" if counted < _LEAST_RUNS[eyes] else "yes"
                *figures, missed = _end(runs, world, look)
                yield [machine, seen_by, after, *figures, f"NO: {missed}" if missed else met]


def _end(runs: Sequence[PositioningRow], world: WorldName, look: str) -> list[str]:
    """How that look of ``runs`` ended, what their world asks, and what of it they miss."""
    worst, before, asked = worst_mm(runs, look), told(runs, look, "before"), WORLDS[world].demands
    least, most = (asked.one_look, None) if look == "look1" else (asked.two_looks, asked.q95_mm)
    checks: list[Check] = [
        at_least("share within 5 mm", share(worst, LIMIT_MM), least),
        at_most("95 %", quantile(worst, 95), most, "mm"),
        *told_checks("told", before, worst, True),
    ]
    missed = [check.what.removeprefix("told: ") for check in checks if check.met is False]
    words = f"≥ {100.0 * (least or 0.0):.0f} %" + (f", 95 % ≤ {most:g} mm" if most else "")
    return [
        str(len(runs)),
        str(int(sum(worst <= LIMIT_MM))),
        ", ".join(f"{quantile(worst, percent):.2f}" for percent in (50, 95, 100)),
        str(sum(bool(run.failure or getattr(run, look).failure) for run in runs)),
        f"{nees(before):.2f}",
        str(silent_misses(before, worst)),
        words,
        ", ".join(missed),
    ]


def _ratios(rows: list[EyesRow]) -> Iterable[Sequence[str]]:
    """A line for each arm, both, and look: the ratio of errors, and which ratio so many pairs would show."""
    groups = {
        words: [row for row in rows if row.arm == WORLDS[world].arm] for world, words in MACHINES.items()
    }
    for machine, group in (groups | {"both": rows}).items():
        for look, after in _LOOKS.items() if group else ():
            pairs = paired(group, look)[0]
            found = compare(pairs)
            yield [
                machine,
                after,
                str(len(pairs.pixels)),
                f"{pairs.pixels_stopped + pairs.model_stopped}",
                f"{found.ratio:.2f}, {found.low:.2f} to {found.high:.2f}",
                f"{found.seen:.2f}",
                f"within {1.0 / FACTOR:.2f} to {FACTOR:g}",
                MET[found.agree],
            ]


def _probabilities(rows: Sequence[MachineRun]) -> Iterable[Sequence[str]]:
    """Of what was told before moving, all branches and both eyes together: how often it came true."""
    for world, machine in MACHINES.items():
        runs = [row.run for row in rows if row.world == world]
        chances = [one for name in BRANCHES for one in told(runs, name, "before")]
        ends = np.concatenate([worst_mm(runs, name) for name in BRANCHES])
        for low, high, count, mean, came_true in reliability(chances, ends):
            yield [machine, f"{low:g} to {high:g}", str(count), f"{mean:.3f}", f"{came_true:.3f}"]
