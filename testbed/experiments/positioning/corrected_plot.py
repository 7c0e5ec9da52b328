"""The picture of a best-mode campaign: how many of the runs end within which error."""

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from testbed.reporting.plots import AXIS_COLOURS, STYLE

_REACH_MM = 8.0  # of the axes


def errors_plot(
    arms: Mapping[str, Sequence[Any]], branches: Mapping[str, str], limit_mm: float, title: str
) -> Figure:
    """For each arm the share of runs (all of them, also the failed) within an error, one line a branch.

    ``arms``: name → rows; ``branches``: field of the rows → words.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.6 * len(arms), 3.6), layout="constrained")
        faces = np.atleast_1d(figure.subplots(1, len(arms), sharey=True))
        for axes, (arm, rows) in zip(faces, arms.items(), strict=True):
            for (name, words), colour in zip(branches.items(), AXIS_COLOURS, strict=True):
                worst = np.array([getattr(row, name).worst_mm for row in rows])
                worst = np.sort(worst[np.isfinite(worst)])
                share = 100.0 * np.arange(1, len(worst) + 1) / len(rows)
                axes.step(
                    np.append(0.0, worst), np.append(0.0, share), where="post", color=colour, label=words
                )
            axes.axvspan(0.0, limit_mm, color="0.5", alpha=0.2, linewidth=0, zorder=0)
            axes.set(xlabel="worse of true |x|, |y| / mm", xlim=(0.0, _REACH_MM), ylim=(0.0, 101.0))
            axes.set_title(f"{arm}: {len(rows)} runs")
        faces[0].set_ylabel("runs within / %")
        faces[0].legend(loc="lower right")
        figure.suptitle(title)
        return figure
