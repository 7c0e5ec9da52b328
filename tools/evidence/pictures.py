"""Pictures of the pages, made of kept rows: how many runs end within which error."""

from collections.abc import Iterable

from matplotlib.figure import Figure

from testbed.campaigns.options import EyesKind
from testbed.campaigns.typed_rows import typed
from testbed.experiments.positioning.corrected import BRANCHES
from testbed.experiments.positioning.corrected_figures import LIMIT_MM
from testbed.experiments.positioning.corrected_plot import errors_plot
from testbed.experiments.positioning.corrected_run import PositioningRow
from testbed.experiments.positioning.worlds import ARMS
from tools.evidence import real_machines
from tools.evidence.kept_rows import ROOT, Kept

IMAGES = ROOT / "docs" / "images"
_WORDS = dict(zip(ARMS, real_machines.MACHINES.values(), strict=True))


def pictures(kept: Iterable[Kept]) -> dict[str, Figure]:
    """Every picture by the stem of its file: machines with known servo valves, and real ones."""
    campaigns = list(kept)
    lab = _runs(one for one in campaigns if one.experiment == "best-mode" and one.rows[0]["world"] == "lab")
    real = [row.run for row in real_machines.rows(campaigns) if row.eyes == EyesKind.MODEL]
    return {
        "best_mode": _ends(lab, "servo valves, known; eyes: model"),
        "real_machines": _ends(real, "real machines: mobile valves, loose steel, a poor camera; eyes: model"),
    }


def _runs(campaigns: Iterable[Kept]) -> list[PositioningRow]:
    return [typed(PositioningRow, row) for one in campaigns for row in one.rows]


def _ends(runs: list[PositioningRow], title: str) -> Figure:
    by_arm = {words: [run for run in runs if run.arm == arm] for arm, words in _WORDS.items()}
    return errors_plot(by_arm, BRANCHES, LIMIT_MM, title)
