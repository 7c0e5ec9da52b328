"""A calibration as tables for the terminal and figures for JSON."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from protocol.errors import MeasurementFailed
from testbed.reporting.console import Columns, listed, table
from vision_pc.application.results import pose_json
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.judgement import Judgement
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.perception.zhang_intrinsics import Intrinsics
from vision_pc.core.se3 import Array


def result_json(result: HandEyeResult) -> dict[str, Any]:
    """All of a calibration for JSON; angles in degrees, residuals in mm and degrees."""
    results: dict[str, Any] = {
        "method": result.method,
        "setup": result.setup.value,
        "X": pose_json(result.X) | {"matrix": result.X},
        "Z": pose_json(result.Z) | {"matrix": result.Z},
        "observability": {
            "samples": result.observability.samples,
            "largest_rotation_deg": math.degrees(result.observability.largest_rotation),
            "second_axis_deg": math.degrees(result.observability.second_axis),
            "verdict": result.observability.reason,
        },
        "samples": [
            {
                "name": name,
                "residual_mm": 1e3 * float(np.linalg.norm(r[:3])),
                "residual_deg": math.degrees(float(np.linalg.norm(r[3:]))),
                "used": bool(inlier),
            }
            for name, r, inlier in zip(result.names, result.residuals, result.inliers, strict=True)
        ],
        "notes": result.notes,
    }
    if result.certificate is not None:
        results["certificate"] = asdict(result.certificate) | {"holds": result.certificate.holds}
    results |= _uncertainty_json(result)
    if result.noise is not None:
        results["noise"] = {
            "camera_deg": math.degrees(result.noise.camera_rotation),
            "camera_mm": 1e3 * result.noise.camera_translation,
            "robot_deg": math.degrees(result.noise.robot_rotation),
            "robot_mm": 1e3 * result.noise.robot_translation,
        }
    return results


def _uncertainty_json(result: HandEyeResult) -> dict[str, Any]:
    """X's covariance and standard deviations, and the camera matrix's part of them, where there are such."""
    results: dict[str, Any] = {}
    if result.covariance is not None:
        std = np.sqrt(np.diag(result.covariance))
        results["covariance_p_theta"] = result.covariance
        results["std_mm"] = 1e3 * std[:3]
        results["std_deg"] = np.degrees(std[3:])
    if result.of_lens is not None:
        std = np.sqrt(np.diag(result.of_lens))
        results["camera_matrix"] = {"std_mm": 1e3 * std[:3], "std_deg": np.degrees(std[3:])}
    return results


def result_table(result: HandEyeResult) -> Table:
    """What a person needs to believe a calibration: X, its certainty, where it is proven, what was seen."""
    where = "in the hand" if result.setup is Setup.EYE_IN_HAND else "in the base"
    pose = se3.to_pose(result.X)
    rows = [
        (f"camera {where}, mm", " ".join(f"{1e3 * p:.3f}" for p in pose.p_m)),
        ("quaternion w x y z", " ".join(f"{q:.6f}" for q in pose.q_wxyz)),
    ]
    f = result_json(result)
    matrix = f.get("camera_matrix", {})
    for words, of in (("standard deviation", f), ("  of which the camera matrix", matrix)):
        for unit, digits in (("mm", 3), ("deg", 4)):
            if f"std_{unit}" in of:
                rows.append((f"{words}, {unit}", " ".join(f"{v:.{digits}f}" for v in of[f"std_{unit}"])))
    for side in ("camera", "robot") if "noise" in f else ():
        noise = f["noise"]
        rows.append((f"noise of {side}", f"{noise[f'{side}_deg']:.4f} deg {noise[f'{side}_mm']:.3f} mm"))
    if result.certificate is not None:
        c = result.certificate
        rows.append(
            ("proof of global optimum", f"{'holds' if c.holds else 'FAILS'} ({c.least_eigenvalue:.1e})")
        )
    rows += [
        ("rotation seen", f"{f['observability']['largest_rotation_deg']:.1f} deg at most"),
        ("about a second axis", f"{f['observability']['second_axis_deg']:.1f} deg rms"),
        ("samples used", f"{int(result.inliers.sum())} of {len(result.names)}"),
    ]
    return table(f"{result.method}, {result.setup}", ("", "value"), rows)


def judgement_json(judgement: Judgement) -> dict[str, Any]:
    """What to believe of a calibration, for JSON."""
    scale = judgement.scale
    return {
        "word": judgement.verdict,
        "doubts": judgement.doubts,
        "scale": None if scale is None else {"factor": scale.factor, "std": scale.std},
        "next_best_noise_ratio": judgement.next_best,
    }


def judgement_lines(judgement: Judgement) -> list[tuple[str, str]]:
    """The verdict for the terminal, each line with its style."""
    lines = []
    if judgement.scale is not None:
        scale = judgement.scale
        lines.append((f"camera lengths fit when multiplied by {scale.factor:.4f} ± {scale.std:.4f}", ""))
    if judgement.next_best is not None:
        lines.append((f"the best reading with a mistake fits {judgement.next_best:.3g} times worse", ""))
    lines += [(f"{'refused' if d.refused else 'questioned'}: {d.reason}", "yellow") for d in judgement.doubts]
    return [*lines, (f"verdict: {judgement.verdict}", "bold")]


def sample_table(result: HandEyeResult) -> Table:
    """Residuals by sample, in the camera's axes."""
    rows = [
        (s["name"], f"{s['residual_mm']:.3f}", f"{s['residual_deg']:.4f}", "" if s["used"] else "left out")
        for s in result_json(result)["samples"]
    ]
    return table("residuals by sample", ("sample", "mm", "deg", ""), rows)


def view_table(found: Intrinsics) -> Table:
    """Reprojection error by view."""
    rows = [
        (name, f"{error:.3f}", "outlying" if name in found.outlying else "")
        for name, error in zip(found.names, found.view_rms_px, strict=True)
    ]
    return table("views", ("view", "rms px", ""), rows)


def coverage_table(found: Intrinsics) -> Table:
    """How many corners fell into each part of the picture."""
    rows = [(f"row {k + 1}", *map(int, line)) for k, line in enumerate(found.coverage)]
    columns = ("", *(str(k + 1) for k in range(found.coverage.shape[1])))
    return table("corners by part of the picture", columns, rows)


class HoldOutRow(NamedTuple):
    """One method on one set: calibrated on one half, prediction error on the other, and exchanged."""

    data: str
    method: str
    samples: int
    hold_out_deg: float
    hold_out_mm: float
    left_out: int
    error: str | None = None


def hold_out(data: str, pairs: PosePairs, only: Iterable[Method] | None = None) -> tuple[HoldOutRow, ...]:
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
        rows.append(
            HoldOutRow(
                data,
                method.value,
                len(pairs),
                float(np.degrees(np.sqrt(np.mean(np.sum(r[:, 3:] ** 2, axis=1))))),
                float(1e3 * np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))),
                int((~result.inliers).sum()),
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
        "left out": lambda r: r.error or r.left_out,
    }
    return listed("calibrated on one half, predicted on the other", columns, rows)
