"""Hua et al. 2024, Fig. 5 and 6: locating knob, switch and key hole with X from each method, 50 times.

The paper's camera (fx 881) looks at an ArUco marker of 50 mm; its corners with pixel noise give the
target's poses by PnP, with the errors along the line of sight that such poses have. 17 samples are taken, 5
of them bad. The classical methods get the 12 that the authors kept by hand; the robust ones get all 17 as
well. A located point goes through a depth camera's measurement, X and the robot's pose of the hand; the
truth is known.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import CornerViews, PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import bundle, methods
from vision_pc.core.se3 import Array

PAPER_MM = {"tsai": 4.4, "horaud": 4.0, "daniilidis": 3.4, "dqcr": 2.9}
PAPER_RECOGNITION = {"tsai": 79.0, "horaud": 83.0, "daniilidis": 88.0, "dqcr": 91.0}
TASKS = {"knob": (0.10, 0.15, 0.02), "switch": (-0.12, 0.10, 0.01), "key hole": (0.05, -0.14, 0.0)}
PAPER_K = np.array([[881.21, 0.0, 640.0], [0.0, 884.22, 360.0], [0.0, 0.0, 1.0]])
MARKER_M = 0.05
KEPT, TAKEN = 12, 17
BUNDLE = "image-space adjustment"


class LocalisationRig(NamedTuple):
    """The errors of the simulated rig, a component.

    Corners in px; the hand's pose as the robot reports it (an uncalibrated arm: repeatable to 0.03 mm, true
    to less); the depth camera's point across and along the line of sight; the tolerance of the key hole.
    """

    corner_px: float = 0.25
    robot_rotation_deg: float = 0.05
    robot_translation_mm: float = 0.5
    point_across_mm: float = 0.3
    point_along_mm: float = 1.0
    tolerance_mm: float = 3.0


class LocalisationRow(NamedTuple):
    """One method and task over all calibrations and repetitions; millimetres.

    ``error_mm`` mean length of the error, ``lowest_mm`` and ``highest_mm`` the 5 % and 95 % quantiles of
    the mean over 50 repetitions, ``from_calibration_mm`` what X alone contributes, ``recognised_percent``
    the share within the key hole's clearance, ``paper_*`` the paper's figures.
    """

    method: str
    samples: str
    task: str
    error_mm: float
    lowest_mm: float
    highest_mm: float
    from_calibration_mm: float
    recognised_percent: float
    failed: int
    paper_mm: float | None
    paper_recognised_percent: float | None


class LocalisationSession(NamedTuple):
    """One calibration session: truth, all samples with corners, and which the authors would have kept."""

    scene: HandEyeScene
    taken: PosePairs
    kept: PosePairs


def localisation(
    runs: int = 20,
    repetitions: int = 50,
    seed: int = 1,
    rig: LocalisationRig | None = None,
) -> tuple[LocalisationRow, ...]:
    """Errors of all methods over ``runs`` simulated calibrations with ``repetitions`` of each task."""
    rig = rig or LocalisationRig()
    return rows_of([_calibration(run, repetitions, seed, rig) for run in range(runs)], rig)


class LocalisedTarget(NamedTuple):
    """One method in one calibration: errors of the whole chain and of X alone (tasks, repetitions), mm.

    Both are None when the method failed.
    """

    method: str
    samples: str
    total: Any
    bias: Any


def calibration_row(task: dict[str, Any]) -> dict[str, Any]:
    """A campaign's row: calibration number ``run`` with ``repetitions`` of each task."""
    entries = _calibration(int(task["run"]), int(task["repetitions"]), int(task["seed"]), LocalisationRig())
    return {
        "entries": [
            [e.method, e.samples, None if e.total is None else np.round(e.total, 5).tolist(),
             None if e.bias is None else np.round(e.bias, 5).tolist()]
            for e in entries
        ]
    }  # fmt: skip


def entries_of(kept: list[Any]) -> list[LocalisedTarget]:
    """What ``calibration_row`` has kept."""
    return [LocalisedTarget(*entry) for entry in kept]


def _calibration(run: int, repetitions: int, seed: int, rig: LocalisationRig) -> list[LocalisedTarget]:
    rng = np.random.default_rng([seed, run])
    session = simulated_session(rig, rng)
    points = _repetitions(session.scene, rig, repetitions, rng)
    entries = []
    for name, samples, X in _calibrations(session, rig):
        errors = (None, None) if X is None else _localisation_errors(points, X, session.scene.X)
        entries.append(LocalisedTarget(name, samples, *errors))
    return entries


def rows_of(
    calibrations: list[list[LocalisedTarget]], rig: LocalisationRig | None = None
) -> tuple[LocalisationRow, ...]:
    """The rows that all calibrations amount to."""
    errors: dict[tuple[str, str], list[Array]] = {}
    biases: dict[tuple[str, str], list[Array]] = {}
    failed: dict[tuple[str, str], int] = {}
    for entry in (entry for entries in calibrations for entry in entries):
        key = (entry.method, entry.samples)
        if entry.total is None:
            failed[key] = failed.get(key, 0) + 1
            continue
        errors.setdefault(key, []).append(np.array(entry.total))
        biases.setdefault(key, []).append(np.array(entry.bias))
    return tuple(
        row
        for key, values in errors.items()
        for row in _rows(key, values, biases[key], failed.get(key, 0), rig or LocalisationRig())
    )


def simulated_session(rig: LocalisationRig, rng: np.random.Generator) -> LocalisationSession:
    """17 views of the marker from about 0.4 m, 5 of them with a pose of the hand from another time."""
    scene = scenes.viewing_scene(rng, TAKEN, distance_m=0.4, tilt_deg=35.0)
    half = 0.5 * MARKER_M
    points = np.array([[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]])
    P = scene.P()
    pixels = np.stack([_project(P[k], points) for k in range(TAKEN)])
    pixels = pixels + rng.normal(size=pixels.shape) * rig.corner_px
    measured = np.stack([_pose_of(points, seen) for seen in pixels])
    turn = stacks.exp_so3(rng.normal(size=(TAKEN, 3)) * math.radians(rig.robot_rotation_deg))
    shift = rng.normal(size=(TAKEN, 3)) * 1e-3 * rig.robot_translation_mm
    X_BT = stacks.transform(scene.X_BT[:, :3, :3] @ turn, scene.X_BT[:, :3, 3] + shift)
    for k in range(KEPT, TAKEN):  # sampled before the arm had settled
        moving = rng.normal(size=3)
        X_BT[k, :3, 3] += moving / np.linalg.norm(moving) * rng.uniform(0.02, 0.1)
        X_BT[k, :3, :3] = X_BT[k, :3, :3] @ stacks.exp_so3(rng.normal(size=3) * math.radians(4.0))
    corners = CornerViews(points, pixels, PAPER_K, np.zeros(5))
    taken = pose_pairs(X_BT, measured, Setup.EYE_IN_HAND, corners=corners)
    kept = pose_pairs(
        X_BT[:KEPT], measured[:KEPT], Setup.EYE_IN_HAND, corners=corners._replace(pixels=pixels[:KEPT])
    )
    return LocalisationSession(scene, taken, kept)


def _project(X_CP: Array, points: Array) -> Array:
    p = points @ X_CP[:3, :3].T + X_CP[:3, 3]
    pixels: Array = (p @ PAPER_K.T)[:, :2] / p[:, 2:]
    return pixels


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


def _calibrations(session: LocalisationSession, rig: LocalisationRig) -> list[tuple[str, str, Array | None]]:
    """X of every method on the samples kept by hand, and of the robust ones on all samples too."""
    by_hand, everything = f"{KEPT} kept by hand", f"all {TAKEN}"
    found = [(m.value, by_hand, _solve(session.kept, m)) for m in Method]
    found.append((Method.HORAUD.value, everything, _solve(session.taken, Method.HORAUD)))
    found.append((Method.DQCR.value, everything, _solve(session.taken, Method.DQCR)))
    found.append((Method.ROBUST.value, everything, _solve(session.taken, Method.ROBUST)))
    robot = bundle.RobotNoise(math.radians(rig.robot_rotation_deg), 1e-3 * rig.robot_translation_mm)
    for pairs, samples in ((session.kept, by_hand), (session.taken, everything)):
        try:
            adjusted = bundle.adjust(pairs, methods.solve(pairs, Method.ROBUST), robot).X
        except MeasurementFailed:
            adjusted = None
        found.append((BUNDLE, samples, adjusted))
    return found


def _solve(pairs: PosePairs, method: Method) -> Array | None:
    try:
        return methods.solve(pairs, method).X
    except MeasurementFailed:
        return None


class _Points(NamedTuple):
    """For each repetition: the hand's true and reported pose, the point in the camera and its truth."""

    X_BT: Array
    X_BT_reported: Array
    measured: Array
    true: Array


def _repetitions(
    scene: HandEyeScene, rig: LocalisationRig, repetitions: int, rng: np.random.Generator
) -> dict[str, _Points]:
    """The tasks' points as seen from ``repetitions`` poses around the calibrated ones."""
    found = {}
    for task, offset in TASKS.items():
        start = scene.X_BT[rng.integers(len(scene.X_BT), size=repetitions)]
        wander = stacks.exp_so3(rng.normal(size=(repetitions, 3)) * math.radians(5.0))
        X_BT = stacks.transform(
            start[:, :3, :3] @ wander, start[:, :3, 3] + rng.normal(size=(repetitions, 3)) * 0.03
        )
        turn = stacks.exp_so3(rng.normal(size=(repetitions, 3)) * math.radians(rig.robot_rotation_deg))
        shift = rng.normal(size=(repetitions, 3)) * 1e-3 * rig.robot_translation_mm
        reported = stacks.transform(X_BT[:, :3, :3] @ turn, X_BT[:, :3, 3] + shift)
        in_base = scene.Z @ np.append(offset, 1.0)
        true = (stacks.inverse(X_BT @ scene.X) @ in_base)[:, :3]
        sigma = 1e-3 * np.array([rig.point_across_mm, rig.point_across_mm, rig.point_along_mm])
        found[task] = _Points(X_BT, reported, true + rng.normal(size=true.shape) * sigma, true)
    return found


def _localisation_errors(points: dict[str, _Points], X: Array, X_true: Array) -> tuple[Array, Array]:
    """Errors (tasks, repetitions) in mm: of the whole chain, and of X alone with all else true."""
    total, bias = [], []
    for p in points.values():
        truth = _through(p.X_BT, X_true, p.true)
        total.append(1e3 * np.linalg.norm(_through(p.X_BT_reported, X, p.measured) - truth, axis=1))
        bias.append(1e3 * np.linalg.norm(_through(p.X_BT, X, p.true) - truth, axis=1))
    return np.array(total), np.array(bias)


def _through(X_BT: Array, X: Array, points: Array) -> Array:
    inside = points @ X[:3, :3].T + X[:3, 3]
    located: Array = (X_BT[:, :3, :3] @ inside[..., None])[..., 0] + X_BT[:, :3, 3]
    return located


def _rows(
    key: tuple[str, str], errors: list[Array], biases: list[Array], failed: int, rig: LocalisationRig
) -> list[LocalisationRow]:
    method, samples = key
    E, bias = np.array(errors), np.array(biases)
    rows = []
    for k, task in enumerate([*TASKS, "all"]):
        mine = E[:, k : k + 1] if task != "all" else E
        of_run = mine.mean(axis=(1, 2))
        low, high = np.quantile(of_run, (0.05, 0.95))
        rows.append(
            LocalisationRow(
                method,
                samples,
                task,
                float(mine.mean()),
                float(low),
                float(high),
                float((bias[:, k] if task != "all" else bias).mean()),
                100.0 * float((mine <= rig.tolerance_mm).mean()),
                failed,
                PAPER_MM.get(method) if task == "all" else None,
                PAPER_RECOGNITION.get(method) if task == "all" else None,
            )
        )
    return rows
