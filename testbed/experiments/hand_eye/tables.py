"""The experiments' rows as tables for the terminal."""

from collections.abc import Iterable, Sequence

from rich.table import Table

from testbed.experiments.hand_eye.intrinsics_experiment import PAPER_RMS_PX, IntrinsicsRow
from testbed.experiments.hand_eye.localisation import LocalisationRow
from testbed.experiments.hand_eye.noise_sweep import SweepRow
from testbed.experiments.hand_eye.real_data import HoldOutRow
from testbed.experiments.hand_eye.stress import StressRow
from testbed.reporting.console import Columns, listed


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


def sweep_table(rows: Sequence[SweepRow], level: int) -> Table:
    """One noise level of the sweep."""
    shown = [r for r in rows if r.level == level]
    first = shown[0]
    title = (
        f"d = {level}, noise on {first.noise_on}, {first.runs} runs; Cramér-Rao bound "
        f"{first.bound_rotation_deg:.4f} deg {first.bound_translation_mm:.3f} mm"
    )
    columns: Columns = {
        "method": "{method}",
        "deg": "{rotation_deg:.4f}",
        "mm": "{translation_mm:.3f}",
        "deg / bound": "{rotation_over_bound:.2f}",
        "mm / bound": "{translation_over_bound:.2f}",
        "NEES": "{nees:.2f}",
        "least eigenvalue": "{least_eigenvalue:.1e}",
        "failed": "{failed}",
    }
    return listed(title, columns, shown)


def localisation_table(rows: Iterable[LocalisationRow]) -> Table:
    """Fig. 5 and 6: all tasks together."""
    columns: Columns = {
        "method": "{method}",
        "samples": "{samples}",
        "mm": "{error_mm:.2f}",
        "5 % … 95 %": "{lowest_mm:.2f} … {highest_mm:.2f}",
        "by X alone": "{from_calibration_mm:.2f}",
        "paper mm": "{paper_mm:.1f}",
        "within 3 mm": "{recognised_percent:.0f} %",
        "paper": "{paper_recognised_percent:.0f} %",
        "failed": "{failed}",
    }
    return listed("localisation of knob, switch and key hole", columns, (r for r in rows if r.task == "all"))


def stress_table(rows: Sequence[StressRow]) -> Table:
    """One scenario of the stress tests."""
    r0 = rows[0]
    title = (
        f"{r0.scenario}, {r0.runs} runs; bound of the good samples {r0.bound_rotation_deg:.4f} deg "
        f"{r0.bound_translation_mm:.2f} mm"
    )
    columns: Columns = {
        "method": "{method}",
        "median deg": "{rotation_median_deg:.4f}",
        "rms deg": "{rotation_rms_deg:.4f}",
        "median mm": "{translation_median_mm:.2f}",
        "rms mm": "{translation_rms_mm:.2f}",
        "95 % mm": "{translation_95_mm:.2f}",
        "refused": "{refused}",
        "improper": "{improper}",
        "bad found": lambda r: _percent(r.found),
        "good lost": lambda r: _percent(r.wrongly_dropped),
        "unproven": "{uncertified}",
    }
    return listed(title, columns, rows)


def intrinsics_table(rows: Iterable[IntrinsicsRow]) -> Table:
    """Fig. 4 with errors."""
    columns: Columns = {
        "pictures": "{pictures}",
        "corners by": "{detector}",
        "views": "{views}",
        "rms px": "{rms_px:.3f}",
        "fx": "{fx_px:.2f}",
        "± px": "{std_fx_px:.2f}",
        "fx error": "{fx_error_percent:+.3f} %",
        "centre off px": "{centre_error_px:.2f}",
        "outlying": lambda r: " ".join(r.outlying) or "–",
        "empty": "{empty_cells_percent:.0f} %",
    }
    return listed(f"intrinsics by Zhang's method (the paper: {PAPER_RMS_PX} px)", columns, rows)


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.1f} %"
