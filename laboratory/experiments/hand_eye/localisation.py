"""Hua et al. 2024, Fig. 5 and 6: locating knob, switch and key hole with X from each method, 50 times.

The paper's camera (fx 881) looks at an ArUco marker of 50 mm; its corners with pixel noise give the
target's poses by PnP, with the errors along the line of sight that such poses have. 17 samples are taken, 5
of them bad. The classical methods get the 12 that the authors kept by hand; the robust ones get all 17 as
well. A located point goes through a depth camera's measurement, X and the robot's pose of the hand; the
truth is known.
"""

import math
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.se3 import Array

PAPER_MM = {"tsai": 4.4, "horaud": 4.0, "daniilidis": 3.4, "dqcr": 2.9}
PAPER_RECOGNITION = {"tsai": "79 %", "horaud": "83 %", "daniilidis": "88 %", "dqcr": "91 %"}
TARGETS = ((0.10, 0.15, 0.02), (-0.12, 0.10, 0.01), (0.05, -0.14, 0.0))  # knob, switch, key hole; m
PAPER_K = np.array([[881.21, 0.0, 640.0], [0.0, 884.22, 360.0], [0.0, 0.0, 1.0]])
MARKER_M = 0.05
KEPT, TAKEN = 12, 17


# The errors of the simulated rig, a component: corners in px; the hand's pose as the robot reports it (an
# uncalibrated arm: repeatable to 0.03 mm, true to less); the depth camera's point across and along the line
# of sight. The tolerance of the key hole.
CORNER_PX = 0.25
ROBOT_RAD, ROBOT_M = math.radians(0.05), 0.5e-3
POINT_M = (0.3e-3, 0.3e-3, 1e-3)
TOLERANCE_MM = 3.0


Errors = dict[tuple[str, str], Array]
"""Method and samples → errors (calibrations, targets, repetitions), mm; NaN where the method failed."""


def calibration_row(_config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """A campaign's row: calibration number ``run`` with ``repetitions`` of each target."""
    rng = np.random.default_rng([task["seed"], task["run"]])
    scene, taken, kept = simulated_session(rng)
    points = _repetitions(scene, task["repetitions"], rng)
    on_all = (Method.HORAUD, Method.DQCR, Method.ROBUST)
    found = [
        *((m.value, f"{KEPT} kept by hand", _solve(kept, m)) for m in Method),
        *((m.value, f"all {TAKEN}", _solve(taken, m)) for m in on_all),
    ]
    return {"entries": [[*key, np.round(_located_mm(points, X, scene.X), 5)] for *key, X in found]}


def errors_of(calibrations: Iterable[list[list[Any]]]) -> Errors:
    """The errors in the ``entries`` of all calibrations."""
    errors: dict[tuple[str, str], list[Any]] = {}
    for method, samples, mm in chain(*calibrations):
        errors.setdefault((method, samples), []).append(mm)
    return {key: np.array(mm, dtype=np.float64) for key, mm in errors.items()}


def simulated_session(rng: np.random.Generator) -> tuple[HandEyeScene, PosePairs, PosePairs]:
    """The truth of 17 views of the marker from about 0.4 m, all samples, 5 of them with a pose of the hand
    from another time, and the 12 that the authors would have kept.
    """
    scene = scenes.viewing_scene(rng, TAKEN, distance_m=0.4, tilt_deg=35.0)
    half = 0.5 * MARKER_M
    points = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    P = scene.P()
    pixels = np.stack([_project(P[k], points) for k in range(TAKEN)])
    pixels = pixels + rng.normal(size=pixels.shape) * CORNER_PX
    measured = np.stack([_pose_of(points, seen) for seen in pixels])
    X_BT = _reported(scene.X_BT, rng)
    for k in range(KEPT, TAKEN):  # sampled before the arm had settled
        moving = rng.normal(size=3)
        X_BT[k, :3, 3] += moving / np.linalg.norm(moving) * rng.uniform(0.02, 0.1)
        X_BT[k, :3, :3] = X_BT[k, :3, :3] @ stacks.exp_so3(rng.normal(size=3) * math.radians(4.0))
    taken = pose_pairs(X_BT, measured, Setup.EYE_IN_HAND)
    return scene, taken, pose_pairs(X_BT[:KEPT], measured[:KEPT], Setup.EYE_IN_HAND)


def _reported(X_BT: Array, rng: np.random.Generator) -> Array:
    """The hand's poses (n, 4, 4) as the robot reports them."""
    turn = stacks.exp_so3(rng.normal(size=(len(X_BT), 3)) * ROBOT_RAD)
    shift = rng.normal(size=(len(X_BT), 3)) * ROBOT_M
    return stacks.transform(X_BT[:, :3, :3] @ turn, X_BT[:, :3, 3] + shift)


def _project(X_CP: Array, points: Array) -> Array:
    p = points @ X_CP[:3, :3].T + X_CP[:3, 3]
    return np.asarray((p @ PAPER_K.T)[:, :2] / p[:, 2:])


def _pose_of(points: Array, pixels: Array) -> Array:
    """The marker's pose by IPPE for squares, refined; of the two solutions the one that fits better."""
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        points, pixels, PAPER_K, np.zeros(5), flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    best = int(np.argmin(np.ravel(errors)))
    turn, shift = cv2.solvePnPRefineLM(points, pixels, PAPER_K, np.zeros(5), turns[best], shifts[best])
    return stacks.transform(
        np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64), np.asarray(shift, dtype=np.float64).ravel()
    )


def _solve(pairs: PosePairs, method: Method) -> Array:
    """X (4, 4), NaN where the method refuses."""
    try:
        return methods.solve(pairs, method).X
    except MeasurementFailed:
        return np.full((4, 4), np.nan)


_Points = tuple[Array, Array, Array, Array]
"""For each repetition: the hand's true and reported pose, the point in the camera and its truth."""


def _repetitions(scene: HandEyeScene, repetitions: int, rng: np.random.Generator) -> list[_Points]:
    """The targets' points as seen from ``repetitions`` poses around the calibrated ones."""
    found: list[_Points] = []
    for offset in TARGETS:
        start = scene.X_BT[rng.integers(len(scene.X_BT), size=repetitions)]
        wander = stacks.exp_so3(rng.normal(size=(repetitions, 3)) * math.radians(5.0))
        X_BT = stacks.transform(
            start[:, :3, :3] @ wander, start[:, :3, 3] + rng.normal(size=(repetitions, 3)) * 0.03
        )
        reported = _reported(X_BT, rng)
        in_base = scene.Z @ np.append(offset, 1.0)
        true = (stacks.inverse(X_BT @ scene.X) @ in_base)[:, :3]
        found.append((X_BT, reported, true + rng.normal(size=true.shape) * POINT_M, true))
    return found


def _located_mm(points: list[_Points], X: Array, X_true: Array) -> Array:
    """Errors (targets, repetitions) of the whole chain, mm."""
    offs = [
        _through(reported, X, measured) - _through(X_BT, X_true, true)
        for X_BT, reported, measured, true in points
    ]
    return np.asarray(1e3 * np.linalg.norm(offs, axis=-1))


def _through(X_BT: Array, X: Array, points: Array) -> Array:
    inside = points @ X[:3, :3].T + X[:3, 3]
    return np.asarray((X_BT[:, :3, :3] @ inside[..., None])[..., 0] + X_BT[:, :3, 3])
