"""The experiments' rows as tables for the terminal."""

from collections.abc import Iterable, Sequence

from rich.table import Table

from testbed.experiments.hand_eye.intrinsics_experiment import PAPER_RMS_PX, IntrinsicsRow
from testbed.experiments.hand_eye.localisation import LocalisationRow
from testbed.experiments.hand_eye.noise_sweep import SweepRow
from testbed.experiments.hand_eye.real_data import HoldOutRow
from testbed.experiments.hand_eye.stress import StressRow
from testbed.reporting.console import table


def hold_out_table(rows: Iterable[HoldOutRow]) -> Table:
    """Two-fold hold-out of all methods."""
    columns = (
        "data",
        "method",
        "samples",
        "hold-out deg",
        "hold-out mm",
        "left out",
        "off ref. deg",
        "off ref. mm",
    )
    return table(
        "calibrated on one half, predicted on the other",
        columns,
        [
            (r.data, r.method, r.samples, "–", "–", "–", r.error or "", "")
            if r.error
            else (
                r.data,
                r.method,
                r.samples,
                f"{r.hold_out_deg:.3f}",
                f"{r.hold_out_mm:.3f}",
                r.left_out,
                _or_dash(r.off_deg, 3),
                _or_dash(r.off_mm, 2),
            )
            for r in rows
        ],
    )


def sweep_table(rows: Sequence[SweepRow], level: int) -> Table:
    """One noise level of the sweep."""
    first = next(r for r in rows if r.level == level)
    title = (
        f"d = {level}, noise on {first.noise_on}, {first.runs} runs; Cramér-Rao bound "
        f"{first.bound_rotation_deg:.4f} deg {first.bound_translation_mm:.3f} mm"
    )
    columns = ("method", "deg", "mm", "deg / bound", "mm / bound", "NEES", "least eigenvalue", "failed")
    return table(
        title,
        columns,
        [
            (
                r.method,
                f"{r.rotation_deg:.4f}",
                f"{r.translation_mm:.3f}",
                f"{r.rotation_over_bound:.2f}",
                f"{r.translation_over_bound:.2f}",
                _or_dash(r.nees, 2),
                "–" if r.least_eigenvalue is None else f"{r.least_eigenvalue:.1e}",
                r.failed,
            )
            for r in rows
            if r.level == level
        ],
    )


def localisation_table(rows: Iterable[LocalisationRow]) -> Table:
    """Fig. 5 and 6: all tasks together."""
    columns = (
        "method",
        "samples",
        "mm",
        "5 % … 95 %",
        "by X alone",
        "paper mm",
        "within 3 mm",
        "paper",
        "failed",
    )
    return table(
        "localisation of knob, switch and key hole",
        columns,
        [
            (
                r.method,
                r.samples,
                f"{r.error_mm:.2f}",
                f"{r.lowest_mm:.2f} … {r.highest_mm:.2f}",
                f"{r.from_calibration_mm:.2f}",
                _or_dash(r.paper_mm, 1),
                f"{r.recognised_percent:.0f} %",
                "–" if r.paper_recognised_percent is None else f"{r.paper_recognised_percent:.0f} %",
                r.failed,
            )
            for r in rows
            if r.task == "all"
        ],
    )


def stress_table(rows: Sequence[StressRow]) -> Table:
    """One scenario of the stress tests."""
    r0 = rows[0]
    title = (
        f"{r0.scenario}, {r0.runs} runs; bound of the good samples {r0.bound_rotation_deg:.4f} deg "
        f"{r0.bound_translation_mm:.2f} mm"
    )
    columns = (
        "method",
        "median deg",
        "rms deg",
        "median mm",
        "rms mm",
        "95 % mm",
        "refused",
        "improper",
        "bad found",
        "good lost",
        "unproven",
    )
    return table(
        title,
        columns,
        [
            (
                r.method,
                f"{r.rotation_median_deg:.4f}",
                f"{r.rotation_rms_deg:.4f}",
                f"{r.translation_median_mm:.2f}",
                f"{r.translation_rms_mm:.2f}",
                f"{r.translation_95_mm:.2f}",
                r.refused,
                r.improper,
                _percent(r.found),
                _percent(r.wrongly_dropped),
                "–" if r.uncertified is None else r.uncertified,
            )
            for r in rows
        ],
    )


def intrinsics_table(rows: Iterable[IntrinsicsRow]) -> Table:
    """Fig. 4 with errors."""
    columns = (
        "pictures",
        "corners by",
        "views",
        "rms px",
        "fx",
        "± px",
        "fx error",
        "centre off px",
        "outlying",
        "empty",
    )
    return table(
        f"intrinsics by Zhang's method (the paper: {PAPER_RMS_PX} px)",
        columns,
        [
            (
                r.pictures,
                r.detector,
                r.views,
                f"{r.rms_px:.3f}",
                f"{r.fx_px:.2f}",
                f"{r.std_fx_px:.2f}",
                "–" if r.fx_error_percent is None else f"{r.fx_error_percent:+.3f} %",
                _or_dash(r.centre_error_px, 2),
                " ".join(r.outlying) or "–",
                f"{r.empty_cells_percent:.0f} %",
            )
            for r in rows
        ],
    )


def _or_dash(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.1f} %"
