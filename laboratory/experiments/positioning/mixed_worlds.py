"""Drawn worlds in which one source of error is another machine's, and all else stays."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import merged
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import WORLDS, WorldName
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.lockstep.simulated_measurements import load_eye_model, simulated_sight
from testbed.scenarios.scenario import load_settings, nested

JSON = dict[str, Any]
OTHER = 1_000_000_000  # from the seed of a world to that of the one it is mixed with
NOISE = "noise"
SOURCES: Mapping[str, tuple[str, ...]] = {
    "task": (
        "plant.start_pose_deg",
        "scene.mount",
        "scene.object_of_interest.position_m",
        "scene.object_of_interest.tilt_deg",
    ),
    "payload": ("plant.payload",),
    "valves": ("plant.actuators", "plant.valve", "plant.oil", "plant.pump"),
    "encoders": ("plant.errors.encoder",),
    "drawing": ("plant.errors.geometry", "plant.errors.base_tilt"),
    "bending": (
        "plant.flexibility",
        "plant.errors.finer_bending",
        "plant.errors.torsion",
        "plant.errors.pin_compliance",
        "plant.errors.rocking_base",
        "plant.errors.vibration",
    ),
    "play": ("plant.errors.backlash", "plant.errors.bearing_tilt", "plant.errors.loose_slew"),
    "camera": ("scene.camera",),
    "plates": ("scene.tool_marker", "scene.object_of_interest.markers"),
    "light": ("scene.lighting", "scene.wall", "scene.passers"),
    NOISE: ("scene.seed", "scene.wall.texture_seed"),
}
"""Source of error → the keys that are it; the longest that fits counts. ``noise`` is the run's seed too."""


def source_of(key: str) -> str:
    """The source that a dotted key belongs to. Raises KeyError for one of none."""
    fitting = {prefix: name for name, some in SOURCES.items() for prefix in some if key.startswith(prefix)}
    if not fitting:
        raise KeyError(key)
    return fitting[max(fitting, key=len)]


def sources_of(config_dir: Path, world: WorldName, arm: str, seed: int) -> tuple[str, ...]:
    """The sources in which one machine of a world differs from another, in their order."""
    mine, other = (dict(_drawn_leaves(config_dir, world, arm, each)) for each in (seed, seed + OTHER))
    found = {source_of(key) for key in {**mine, **other} if mine.get(key) != other.get(key)} | {NOISE}
    return tuple(name for name in SOURCES if name in found)


def mixed(config_dir: Path, world: WorldName, arm: str, seed: int, source: str) -> JSON:
    """The world of ``seed`` with ``source`` as it is in that of ``seed + OTHER``, as overrides.

    ``source``: "A": none, "B": all of them.
    """
    mine, other = (dict(_drawn_leaves(config_dir, world, arm, each)) for each in (seed, seed + OTHER))
    overrides: JSON = {}
    for key in {**mine, **other}:
        same = mine.get(key) == other.get(key)  # what all machines have belongs to no source
        taken = mine if same or source not in ("B", source_of(key)) else other
        if key in taken:
            overrides = merged(overrides, nested(key, taken[key]))
    return overrides


def mixed_rig(config_dir: Path, world: WorldName, arm: str, seed: int, source: str) -> LockstepRig:
    """The rig of a mixed world, with the model's eyes, at its start."""
    settings = load_settings(config_dir, mixed(config_dir, world, arm, seed, source))
    drawn_by = seed + OTHER if source in ("B", NOISE) else seed
    model = load_eye_model(config_dir, WORLDS[world].eyes)
    return LockstepRig(settings, drawn_by, RunLog(), partial(simulated_sight, model=model, seed=drawn_by))


def _drawn_leaves(config_dir: Path, world: WorldName, arm: str, seed: int) -> Iterator[tuple[str, Any]]:
    return _leaves(draw(config_dir, seed, arm, WORLDS[world]).overrides)


def _leaves(overrides: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in overrides.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


Array = NDArray[np.float64]
_RESAMPLES = 2000
_SHARE = 95.0  # of an interval, percent


class Runs(NamedTuple):
    """Results of n samples, m numbers each, NaN where a run failed.

    ``A`` (n, m), ``B`` (n, m): of independent worlds. ``AB`` (d, n, m): of A with group i taken from B.
    """

    A: Array
    B: Array
    AB: Array

    def whole(self) -> "Runs":
        """The samples all of whose runs succeeded."""
        fine = np.isfinite(self.A).all(axis=1) & np.isfinite(self.B).all(axis=1)
        fine &= np.isfinite(self.AB).all(axis=(0, 2))
        return Runs(self.A[fine], self.B[fine], self.AB[:, fine])


class SobolIndices(NamedTuple):
    """Shares (d,) of the variance: ``first`` by a group alone, ``total`` with all that it acts together with.

    ``variance``: of all m numbers together.
    """

    first: Array
    total: Array
    variance: float


class Limited(NamedTuple):
    """Indices with their 95 % intervals (2, d), and how often (d,) each group's total is the greatest."""

    indices: SobolIndices
    first_ends: Array
    total_ends: Array
    greatest: Array


def sobol(runs: Runs) -> SobolIndices:
    """The indices of runs of which none failed; NaN where nothing varies."""
    middle = np.concatenate([runs.A, runs.B]).mean(axis=0)
    A, B, AB = runs.A - middle, runs.B - middle, runs.AB - middle
    variance = float(np.concatenate([A, B]).var(axis=0).sum())
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (B * (AB - A)).mean(axis=1).sum(axis=1) / variance
        total = 0.5 * ((A - AB) ** 2).mean(axis=1).sum(axis=1) / variance
    return SobolIndices(first, total, variance)


def limited(runs: Runs, seed: int) -> Limited:
    """The indices with intervals by the bootstrap over samples (percentiles), drawn by ``seed``."""
    rng = np.random.default_rng(seed)
    n = len(runs.A)
    drawn = [
        sobol(Runs(runs.A[picked], runs.B[picked], runs.AB[:, picked]))
        for picked in rng.integers(0, n, (_RESAMPLES, n))
    ]
    first, total = (np.array([getattr(one, name) for one in drawn]) for name in ("first", "total"))
    ends = (50.0 - _SHARE / 2.0, 50.0 + _SHARE / 2.0)
    first_ends, total_ends = (np.nanpercentile(some, ends, axis=0) for some in (first, total))
    counts = np.bincount(np.argmax(np.nan_to_num(total), axis=1), minlength=len(runs.AB))
    return Limited(sobol(runs), first_ends, total_ends, counts / _RESAMPLES)
