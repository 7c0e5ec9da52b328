"""Guided sessions in lockstep against the truth: error of X, its covariance, samples needed, localisation.

One run is one drawn world. The session takes its samples at the poses it finds most informative; a second one
in the same world takes them at random poses that keep the same bounds. Then the cabinet's three targets are
located from many poses. The truth comes from the plant.
"""

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plant_emulator.config.surroundings import CabinetConfig
from plant_emulator.core.camera.cabinet import board_points, board_pose
from plant_emulator.core.camera.scene import Scene
from protocol.errors import MeasurementFailed, MotionUnsettled, RequestRefused
from testbed.lockstep import rig as lockstep_rig
from testbed.lockstep.rig import GuidedRig, quiet
from testbed.scenarios.scenario import chosen_overrides, load_settings
from vision_pc.application.hand_eye.sensing import ended_in_fault
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.guided.session import Session
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

TARGETS = ("knob", "switch", "key hole")
LIMIT_MM = 3.0
LOCATING = (Method.TSAI, Method.HORAUD, Method.DANIILIDIS, Method.DQCR, Method.ROBUST)
_WANDER_DEG, _WANDER_M = 10.0, 0.07
_TRIES = 1.6  # times the repetitions wanted: poses where the tool hides a target, or that are refused
_LEAST = 3


def one_run(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one seeded world; ``task``: ``scenario``, ``seed``, ``repetitions`` (0: nothing is located)
    and ``random`` (a second session at random poses).

    ``guided_<n>_mm`` and ``random_<n>_mm``: error of X after n samples (None: no answer); ``*_needed``: with
    how many it came under 3 mm and stayed there (None: never); ``nees`` by the samples' noise alone, and
    ``nees_arm`` with arm and camera; per target the mean error in the hand by each method, and in the base by
    the robust one.
    """
    seed = int(task["seed"])
    settings = load_settings(config_dir, chosen_overrides(config_dir, task["scenario"], seed, []))
    with tempfile.TemporaryDirectory() as sessions:
        rig = GuidedRig(settings, seed, Path(sessions))
        check = lockstep_rig.start(rig, "guided", seed)
        faults = lockstep_rig.take_all(rig, informative=True)
        session = rig.guided.session
        rig.run(rig.guided.solve())
        row: dict[str, Any] = {"seed": seed, "promised_mm": 1e3 * check.promised_std[0]}
        row |= _errors_of_X(session, rig.X_TC) | _curve("guided", session, rig.X_TC)
        row |= _localisation(rig, session, task["repetitions"], seed)
        if task["random"]:
            other = GuidedRig(settings, seed, Path(sessions))
            lockstep_rig.start(other, "random", seed)
            faults += lockstep_rig.take_all(other, informative=False)
            at_random = _curve("random", other.guided.session, rig.X_TC)
            row |= at_random | {"curves": row["curves"] | at_random["curves"]}
    return row | {"guided_refused": len(session.refused), "faults": faults + row.get("locating_faults", 0)}


def _solution_of_first(session: Session, count: int, method: Method = Method.ROBUST) -> HandEyeResult | None:
    """The answer of the first ``count`` samples: the session's own (robust, with the arm), or another's."""
    first = replace(session, samples=session.samples[:count])
    try:
        if method is Method.ROBUST:
            return guided_solution.solve(first).result
        return methods.solve(first.pairs(), method)
    except MeasurementFailed:
        return None


def _errors_of_X(session: Session, X_TC: Array) -> dict[str, Any]:
    """Error of X over all samples, its predicted standard deviation, and how the two agree.

    X is the camera against the tool's true frame. What turns the reported frame against that one (the last
    joint's zero, the tool bolted on askew) is part of the error, and by its prior part of the covariance.
    """
    result, whole, _, _ = guided_solution.solve(session)
    assert result.covariance is not None
    error = se3.local(result.X, X_TC)
    return {
        "error_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "error_deg": math.degrees(float(np.linalg.norm(error[3:]))),
        "std_mm": 1e3 * float(np.sqrt(np.trace(result.covariance[:3, :3]))),
        "std_deg": math.degrees(float(np.sqrt(np.trace(result.covariance[3:, 3:])))),
        "std_arm_mm": 1e3 * float(np.sqrt(np.trace(whole[:3, :3]))),
        "std_arm_deg": math.degrees(float(np.sqrt(np.trace(whole[3:, 3:])))),
        "nees": float(error @ np.linalg.solve(result.covariance, error)),
        "nees_arm": float(error @ np.linalg.solve(whole, error)),
        "left_out": int((~result.inliers).sum()),
        "certified": bool(result.certificate is not None and result.certificate.holds),
    }


def _curve(kind: str, session: Session, X_TC: Array) -> dict[str, Any]:
    """The error of X after each number of samples, and how many were needed to stay under the limit."""
    errors: list[float | None] = []
    for count in range(_LEAST, len(session.samples) + 1):
        result = _solution_of_first(session, count)
        error = None if result is None else 1e3 * float(np.linalg.norm(result.X[:3, 3] - X_TC[:3, 3]))
        errors.append(error)
    curve = {f"{kind}_{_LEAST + k}_mm": error for k, error in enumerate(errors)}
    return {"curves": curve, f"{kind}_needed": needed(errors)}


def needed(errors: list[float | None], limit: float = LIMIT_MM, first: int = _LEAST) -> int | None:
    """With how many samples (``first`` for errors[0]) the errors come under ``limit`` and stay, or None."""
    good = [error is not None and error < limit for error in errors]
    for k in range(len(good)):
        if all(good[k:]):
            return first + k
    return None


def _localisation(rig: GuidedRig, session: Session, repetitions: int, seed: int) -> dict[str, Any]:
    """Errors of the three targets over ``repetitions`` poses around the starting pose."""
    if repetitions == 0:
        return {}
    answers = {m.value: _solution_of_first(session, len(session.samples), m) for m in LOCATING}
    found = {name: result.X for name, result in answers.items() if result is not None}
    rng = np.random.default_rng([seed, 3])
    start = session.around.X_BT_start
    hand: dict[tuple[str, str], list[float]] = {}
    base: dict[str, list[float]] = {}
    done = refused = unseen = faults = 0
    rig.run(rig.guided.back(quiet))
    for _ in range(math.ceil(_TRIES * repetitions)):
        if done == repetitions:
            break
        turn = se3.exp_so3(np.radians(rng.uniform(-_WANDER_DEG, _WANDER_DEG, 3)))
        pose = se3.transform(start[:3, :3] @ turn, start[:3, 3] + rng.uniform(-_WANDER_M, _WANDER_M, 3))
        try:
            rig.run(rig.arm.move_to(pose))
            seen = rig.run(rig.guided.locate(quiet))
        except RequestRefused as error:
            refused += 1
            if ended_in_fault(error):
                faults += 1
                lockstep_rig.recover(rig)
            continue
        except (MeasurementFailed, MotionUnsettled):
            unseen += 1
            continue
        done += 1
        true_T, true_B = _true_targets(rig)
        for target in seen.targets:
            name = target.name
            for method, X in found.items():
                in_hand = se3.apply(X, target.p_C[None])[0]
                hand.setdefault((name, method), []).append(float(np.linalg.norm(in_hand - true_T[name])))
            base.setdefault(name, []).append(float(np.linalg.norm(seen.in_base(target) - true_B[name])))
    row: dict[str, Any] = {
        "located": done, "not_reached": refused, "not_seen": unseen, "locating_faults": faults,
    }  # fmt: skip
    return row | {"targets": _target_columns(hand, base)}


def _target_columns(
    hand: dict[tuple[str, str], list[float]], base: dict[str, list[float]]
) -> dict[str, float]:
    """Means by target and method, spread and share within the limit of the robust one; m in, mm out."""
    targets: dict[str, float] = {}
    for (name, method), errors in hand.items():
        targets[f"{word_of(name)}_{method}_mm"] = 1e3 * float(np.mean(errors))
        if method == Method.ROBUST.value:
            targets[f"{word_of(name)}_spread_mm"] = 1e3 * float(np.std(errors))
            within = np.array(errors) < 1e-3 * LIMIT_MM
            targets[f"{word_of(name)}_within_percent"] = 100.0 * float(np.mean(within))
    for name, errors in base.items():
        targets[f"{word_of(name)}_base_mm"] = 1e3 * float(np.mean(errors))
    return targets


def word_of(target: str) -> str:
    """A target's name as rows have it."""
    return target.replace(" ", "_")


def _true_targets(rig: GuidedRig) -> tuple[dict[str, Array], dict[str, Array]]:
    """The targets' places at this moment as they truly are: in the hand T, and in the base B."""
    scene = Scene(rig.settings.scene)
    board = next(b for b in rig.settings.scene.boards if isinstance(b, CabinetConfig))
    truth = rig.world.plant.truth()
    points = se3.apply(scene.mounts.X_WO @ board_pose(board), board_points(board))
    X_TW = scene.mounts.X_TC @ se3.inverse(truth.X_WC)
    in_hand, in_base = se3.apply(X_TW, points), se3.apply(se3.inverse(truth.X_WB), points)
    return dict(zip(TARGETS, in_hand, strict=True)), dict(zip(TARGETS, in_base, strict=True))
