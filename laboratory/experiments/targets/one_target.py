"""One target of one drawn wall, measured by the shipped code and compared with the truth."""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from laboratory.experiments.targets.drawn_walls import GROUP, Aspect, DrawnWall, drawn_wall
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.targets.measuring import at_click, holes
from vision_pc.core.targets.sighting import Click, Sighted
from vision_pc.core.targets.target import TargetObservation, TargetRefused

NAN = float("nan")
_STREAM = 0x73757266
_SAME_M = 0.02  # a hole that is told farther from every true one is none
_WRONG_SIGMAS, _WRONG_SHARE = 5.0, 0.01  # of what is told, and of the depth: beyond both it is another place
JSON = dict[str, Any]


class Kinded(NamedTuple):
    """A row of the table: what is asked for there, how the wall is looked at, what limits hold."""

    words: str
    kind: str
    aspect: Aspect
    lateral_mm: float | None = None


ROWS = {
    "hole-0.4": Kinded("hole, 0.4 m", "hole", Aspect(0.4), 0.5),
    "hole-0.7": Kinded("hole, 0.7 m", "hole", Aspect(0.7), 0.5),
    "hole-1.0": Kinded("hole, 1 m", "hole", Aspect(1.0), 0.5),
    "hole-1.5": Kinded("hole, 1.5 m", "hole", Aspect(1.5), 1.0),
    "hole-2.0": Kinded("hole, 2 m", "hole", Aspect(2.0), 1.0),
    "broken-1.0": Kinded("hole, rim broken by 0.2 to 0.4 r", "hole", Aspect(1.0, broken=(0.2, 0.4)), 0.5),
    "oblique-1.0": Kinded("hole, 30 to 45° aslant", "hole", Aspect(1.0, (30.0, 45.0)), 0.5),
    "plane-0.7": Kinded("click, 0.7 m", "plane", Aspect(0.7, broken=None), 0.5),
    "plane-1.0": Kinded("click, 1 m", "plane", Aspect(1.0, broken=None), 0.5),
    "plane-1.5": Kinded("click, 1.5 m", "plane", Aspect(1.5, broken=None), 1.0),
    "plane-2.0": Kinded("click, 2 m", "plane", Aspect(2.0, broken=None), 1.0),
    "slanted-1.0": Kinded("click, 30 to 45° aslant", "plane", Aspect(1.0, (30.0, 45.0), None), 0.5),
    "bare": Kinded("click on a bare wall", "bare", Aspect(1.0, broken=None)),
    "repetitive": Kinded("click on a chessboard", "repetitive", Aspect(1.0, (0.0, 35.0), None)),
}
"""Name → row; a task names one."""
REFUSING = ("bare", "repetitive")  # rows whose walls have nothing that one pair could tell rightly


class TargetError(NamedTuple):
    """Errors of a target: across the line of sight, along it (told less true), of the normal.

    ``nees…``: error² over the variance told, for each degree of freedom: of all, across (2), along, of the
    normal (2). Of a clicked place that across is left out of all: it is where the click's own ray goes.
    """

    lateral_mm: float = NAN
    depth_mm: float = NAN
    normal_deg: float = NAN
    nees: float = NAN
    nees_lateral: float = NAN
    nees_depth: float = NAN
    nees_normal: float = NAN


class TargetRow(NamedTuple):
    """One scene. ``visible`` holes of our width, ``found`` of them; ``false`` holes where there is none.

    ``seen``: as vision has it, with what the tool's marker tells of the camera; ``known``: the same with the
    true camera, so that what is left is the measurement alone. ``refused``: why nothing was told. ``wrong``:
    another place than the one that was clicked was told. ``measure_ms``: CPU time of the target alone.
    """

    row: str
    seed: int
    distance_m: float
    tilt_deg: float
    contrast: float
    visible: int
    found: int
    false: int
    refused: str
    wrong: bool
    diameter_mm: float
    measure_ms: float
    seen: TargetError
    known: TargetError
    failure: str
    cpu_s: float


def one_target(config_dir: Path, task: JSON) -> JSON:
    """The row of one drawn wall; ``task`` has row and seed."""
    asked, seed = ROWS[task["row"]], int(task["seed"])
    wall = drawn_wall(config_dir, seed, asked.aspect, _surface(asked.kind, seed))
    about = {
        "row": task["row"], "seed": seed, "distance_m": asked.aspect.distance_m,
        "tilt_deg": wall.tilt_deg, "contrast": wall.contrast,
    }  # fmt: skip
    return about | (_of_hole(wall) if asked.kind == "hole" else _of_click(wall, asked.kind))


def _surface(kind: str, seed: int) -> JSON:
    """What the walls of a row have other than those of the rest."""
    group = seed // GROUP
    if kind == "bare":
        return {"texture_seed": group, "contrast_grey": 0.5 * (group % 3), "bare_patches": []}
    if kind == "repetitive":
        return {"square_m": float(np.random.default_rng([seed, _STREAM]).uniform(0.01, 0.04))}
    return {}


def _of_click(wall: DrawnWall, kind: str) -> JSON:
    """On a wall without holes; one told is wrong. What must be refused is clicked as on the console."""
    click = Click("left", wall.pixel, "auto" if kind in REFUSING else "plane")
    began = time.process_time()
    try:
        seen = at_click(wall.seen, click)
    except TargetRefused as refused:
        return {"refused": refused.cause, "wrong": False, "measure_ms": _ms_since(began)}
    spent = _ms_since(began)
    error = target_error(seen, wall.aim, seen.covariance)
    return {
        "refused": "",
        "wrong": seen.kind == "hole" or _elsewhere(seen, wall.aim),
        "measure_ms": spent,
        "seen": error,
        "known": _error_with_true_camera(wall.known, click, wall.aim),
    }


def _of_hole(wall: DrawnWall) -> JSON:
    began = time.process_time()
    told = holes(wall.seen)
    spent = _ms_since(began)
    near = np.array([[_across(hole.X_CO[:3, 3], p) < _SAME_M for p in wall.places] for hole in told])
    near = near.reshape(len(told), len(wall.places))
    row = {
        "visible": int(wall.whole.sum()),
        "found": int((near.any(axis=0) & wall.whole).sum()),
        "false": int((~near.any(axis=1)).sum()),
        "measure_ms": spent,
        "wrong": False,
    }
    try:
        seen = at_click(wall.seen, Click("left", wall.pixel, "hole"))
    except TargetRefused as refused:
        return row | {"refused": refused.cause}
    assert seen.diameter_m is not None
    return row | {
        "refused": "",
        "diameter_mm": 1e3 * seen.diameter_m,
        "seen": target_error(seen, wall.aim, seen.covariance),
        "known": _error_with_true_camera(wall.known, Click("left", wall.pixel, "hole"), wall.aim),
    }


def target_error(
    seen: TargetObservation, true: Array, covariance: Array, along_too: bool = True
) -> TargetError:
    """How ``seen`` differs from the frame ``true`` (4, 4), and by how much more than ``covariance`` says.

    ``along_too``: False leaves what lies along the line of sight out of all.
    """
    p = true[:3, 3]
    ray = p / np.linalg.norm(p)
    off = se3.local(seen.X_CO, true)  # true less told
    across = np.zeros((6, 2))
    across[:3] = np.linalg.svd(ray[None])[2][1:].T
    along = np.append(ray, np.zeros(3))[:, None]
    normal = np.zeros((6, 2))
    normal[3:] = seen.X_CO[:3, :2]
    parts = [normal] if seen.kind == "plane" else [across, normal]
    every = np.hstack([along, *parts] if along_too else parts)
    shares = [_share(off, covariance, part) for part in (every, across, along, normal)]
    turned = float(np.degrees(np.arccos(min(float(seen.X_CO[:3, 2] @ true[:3, 2]), 1.0))))
    return TargetError(
        1e3 * float(np.linalg.norm(off @ across)), -1e3 * float(off[:3] @ ray), turned, *shares
    )


def _share(off: Array, covariance: Array, axes: Array) -> float:
    e = off @ axes
    return float(e @ np.linalg.solve(axes.T @ covariance @ axes, e) / axes.shape[1])


def _error_with_true_camera(sighted: Sighted, click: Click, true: Array) -> TargetError:
    """With the true camera; the covariance is that of the measurement alone."""
    try:
        seen = at_click(sighted, click)
    except TargetRefused:
        return TargetError()
    return target_error(seen, true, seen.covariance - seen.bias)


def _elsewhere(seen: TargetObservation, true: Array) -> bool:
    """Whether what was told is another place than the true one."""
    p = true[:3, 3]
    off = abs(float(seen.X_CO[2, 3] - p[2]))
    told = float(np.sqrt(seen.covariance[2, 2]))
    return off > _WRONG_SIGMAS * told and off > _WRONG_SHARE * float(p[2])


def _across(p: Array, q: Array) -> float:
    """How far ``p`` (3,) lies beside the line of sight to ``q`` (3,)."""
    ray = q / np.linalg.norm(q)
    return float(np.linalg.norm(p - q - ray * (ray @ (p - q))))


def _ms_since(began: float) -> float:
    return 1e3 * (time.process_time() - began)
