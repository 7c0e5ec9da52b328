"""Is X's covariance honest when the camera matrix came from the same pictures? Checked against exact truth.

Boards are seen by a camera whose matrix Zhang's method then estimates from the very corners that give the
poses, as anyone does who has one set of pictures.
"""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from testbed.campaigns.experiment import Check, show_checks
from testbed.experiments.hand_eye import scenes
from testbed.reporting.console import bars, out, table, write_json
from vision_pc.core import se3, se3_stacks
from vision_pc.core.hand_eye.samples import CornerViews, KnownLens, pose_pairs
from vision_pc.core.hand_eye.solvers import lens, methods
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import BoardView
from vision_pc.core.se3 import Array

_SIZE = (1280, 720)
_K = np.array([[1050.0, 0.0, 655.0], [0.0, 1050.0, 352.0], [0.0, 0.0, 1.0]])
_DISTORTION = np.array([-0.04, 0.01, 0.0005, -0.0003, 0.0])
_CORNER_PX = 0.15
_POSES = 20
_HAND = scenes.noise(0.01, 0.05, robot=True)
HONEST = (4.0, 9.0)  # mean NEES of six degrees of freedom


class CameraShareRow(NamedTuple):
    """One drawn calibration: squared error of X over its covariance without and with the lens's share."""

    focal_error_percent: float
    error_mm: float
    error_deg: float
    nees_samples: float
    nees: float


def drawn(seed: int) -> CameraShareRow:
    """A hand-eye calibration with the camera matrix from its own pictures."""
    rng = np.random.default_rng([41, seed])
    scene = scenes.viewing_scene(rng, _POSES, distance_m=0.6, tilt_deg=35.0)
    rows, columns = np.mgrid[0:7, 0:10]
    points = np.stack([columns.ravel() - 4.5, rows.ravel() - 3.0, np.zeros(70)], axis=1) * 0.025
    pixels = [_seen(points, P, rng) for P in scene.P()]
    views = [BoardView(str(k), points, seen) for k, seen in enumerate(pixels)]
    found = zhang.calibrate(views, *_SIZE)
    turn = se3_stacks.exp_so3(rng.normal(size=(_POSES, 3)) * _HAND.robot_rotation)
    moved = scene.X_BT[:, :3, 3] + rng.normal(size=(_POSES, 3)) * _HAND.robot_translation
    X_BT = se3_stacks.transform(scene.X_BT[:, :3, :3] @ turn, moved)
    corners = CornerViews(points, np.stack(pixels), found.K, found.distortion)
    pairs = pose_pairs(X_BT, found.X_CB, corners=corners)
    result = methods.solve(pairs)
    assert result.covariance is not None
    of_lens = lens.share(pairs, result, KnownLens(found.K, found.distortion, found.covariance))
    error = se3.local(result.X, scene.X)
    return CameraShareRow(
        100.0 * (found.K[0, 0] / _K[0, 0] - 1.0),
        1e3 * float(np.linalg.norm(error[:3])),
        float(np.degrees(np.linalg.norm(error[3:]))),
        float(error @ np.linalg.solve(result.covariance, error)),
        float(error @ np.linalg.solve(result.covariance + of_lens, error)),
    )


def _seen(points: Array, P: Array, rng: np.random.Generator) -> Array:
    pixels = cv2.projectPoints(points, cv2.Rodrigues(P[:3, :3])[0], P[:3, 3], _K, _DISTORTION)[0]
    return (
        np.asarray(pixels, dtype=np.float64).reshape(-1, 2) + rng.normal(size=(len(points), 2)) * _CORNER_PX
    )


def run_camera_share(runs: int, seed: int, json_file: Path | None) -> bool:
    """Print the mean NEES without and with the lens's share. Returns whether the latter is honest."""
    with bars() as shown, shown.step("drawn calibrations") as bar:
        rows = []
        for k in range(runs):
            rows.append(drawn(seed + k))
            bar.update((k + 1) / runs)
    figures = np.array(rows)
    quantiles = [(name, *(f"{v:.4g}" for v in np.percentile(column, (10, 50, 90))), f"{column.mean():.3g}")
                 for name, column in zip(CameraShareRow._fields, figures.T, strict=True)]  # fmt: skip
    out.print(table(f"{runs} calibrations", ("", "10 %", "median", "90 %", "mean"), quantiles))
    mean = float(figures[:, -1].mean())
    check = Check("mean NEES with the lens", f"{mean:.2f}", f"{HONEST[0]:g} to {HONEST[1]:g}",
                  HONEST[0] <= mean <= HONEST[1])  # fmt: skip
    show_checks([check])
    write_json(json_file, {"rows": rows, "checks": [check]})
    return bool(check.met)
