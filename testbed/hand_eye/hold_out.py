"""Methods on samples whose truth nobody knows: calibrated on one half, predicted on the other."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from protocol.errors import MeasurementFailed
from testbed.reporting.console import Columns, listed
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.se3 import Array


class HoldOutRow(NamedTuple):
    """One method on one set: calibrated on one half, prediction error on the other, and exchanged.

    ``off_*`` compare X from all samples with the published reference, where there is one.
    """

    data: str
    method: str
    samples: int
    hold_out_deg: float
    hold_out_mm: float
    left_out: int
    off_deg: float | None = None
    off_mm: float | None = None
    error: str | None = None


def hold_out(
    data: str, pairs: PosePairs, reference: Array | None = None, only: Iterable[Method] | None = None
) -> tuple[HoldOutRow, ...]:
    """Root-mean-square errors of two-fold hold-out; halves are alternate samples in canonical order."""
    rows = []
    even = np.arange(len(pairs)) % 2 == 0
    for method in only if only is not None else Method:
        try:
            result = methods.solve(pairs, method)
            parts = [_prediction_errors(pairs, fold, method) for fold in (even, ~even)]
        except MeasurementFailed as error:
            rows.append(HoldOutRow(data, method.value, len(pairs), np.nan, np.nan, 0, error=str(error)))
            continue
        r = np.concatenate(parts)
        off = None if reference is None else stacks.inverse(reference) @ result.X
        rows.append(
            HoldOutRow(
                data,
                method.value,
                len(pairs),
                float(np.degrees(np.sqrt(np.mean(np.sum(r[:, 3:] ** 2, axis=1))))),
                float(1e3 * np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))),
                int((~result.inliers).sum()),
                None if off is None else float(np.degrees(stacks.angle(off[:3, :3]))),
                None if off is None else float(1e3 * np.linalg.norm(off[:3, 3])),
            )
        )
    return tuple(rows)


def _prediction_errors(pairs: PosePairs, fold: np.ndarray[Any, np.dtype[np.bool_]], method: Method) -> Array:
    found = methods.solve(pairs.subset(fold), method)
    other = pairs.subset(~fold)
    return ml.residuals(other.H, other.P, found.X, found.Z)


def hold_out_table(rows: Iterable[HoldOutRow]) -> Table:
    """Two-fold hold-out of all methods."""
    columns: Columns = {
        "data": "{data}",
        "method": "{method}",
        "samples": "{samples}",
        "hold-out deg": lambda r: "–" if r.error else f"{r.hold_out_deg:.3f}",
        "hold-out mm": lambda r: "–" if r.error else f"{r.hold_out_mm:.3f}",
        "left out": lambda r: "–" if r.error else r.left_out,
        "off ref. deg": lambda r: r.error or ("–" if r.off_deg is None else f"{r.off_deg:.3f}"),
        "off ref. mm": lambda r: "" if r.error else "–" if r.off_mm is None else f"{r.off_mm:.2f}",
    }
    return listed("calibrated on one half, predicted on the other", columns, rows)
