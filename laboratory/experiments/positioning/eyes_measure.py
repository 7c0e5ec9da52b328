"""What pictures do to corners and tracked points, measured against the truth and written down for the model.

Every refined corner is compared with the exact projection. The noise of tracked points does not show by
itself: the model is led along the very same paths with noises that are known, and the errors that odometry
made in pictures are set against the model's.
"""

import datetime
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.experiments.positioning.corrected_run import driven, prepared
from laboratory.experiments.positioning.eyes_notes import Followed, Notes, noting_sight
from laboratory.experiments.positioning.worlds import WORLDS
from plant_emulator.core.camera.scene import Scene
from protocol.errors import LongreachError, MeasurementFailed
from testbed.lockstep.simulated_odometry import ModelOdometry, TrackingNoise
from testbed.lockstep.true_view import TrueView
from testbed.reporting.console import table
from testbed.scenarios.scenario import Settings
from vision_pc.core import se3
from vision_pc.core.odometry.limits import MINIMUM_INLIERS
from vision_pc.core.se3 import Array

JSON = dict[str, Any]
_KNOWN_PX = 0.1  # noise with which the model is led along the measured paths
_LEAST_GROUP = 4  # frames at one place from which its bias can be told from noise
CONDITIONS = {world.eyes: name for name, world in reversed(list(WORLDS.items()))}
"""Condition of the eye model → the first of the worlds that is seen so."""


def one_run(config_dir: Path, task: JSON) -> JSON:
    """The row of one seed in pictures: sums over corners, and odometry's errors beside the model's."""
    notes = Notes()
    asked = {"seed": task["seed"], "condition": task["condition"]}
    rig = prepared(config_dir, task | {"eyes": "pixels"}, partial(noting_sight, notes=notes))
    try:
        if failure := driven(rig, {}).failure:
            return asked | {"failure": failure}
    except LongreachError as error:
        return asked | {"failure": f"{error.cause}: {error}"}
    return asked | _corners(notes) | _tracks(notes, rig.world.settings, task["seed"])


def _corners(notes: Notes) -> JSON:
    groups = [np.array(errors) for errors in notes.corners.values() if len(errors) >= _LEAST_GROUP]
    inside = sum(float(((g - g.mean(axis=0)) ** 2).sum()) for g in groups)
    freedom = sum(2 * (len(g) - 1) for g in groups)
    noise2 = inside / max(freedom, 1)
    biases = [float((g.mean(axis=0) ** 2).sum()) - 2.0 * noise2 / len(g) for g in groups]
    means = np.array([g.mean(axis=0) for g in groups]).reshape(-1, 2)
    return {
        "corner_noise2": noise2,
        "corner_bias2": float(np.sum(biases)) / max(2 * len(groups), 1),
        "corner_mean_x_px": float(means[:, 0].mean()) if len(means) else None,
        "corner_mean_y_px": float(means[:, 1].mean()) if len(means) else None,
        "corner_places": len(groups),
        "markers_expected": notes.expected,
        "markers_missed": notes.missed,
    }


def _tracks(notes: Notes, settings: Settings, seed: int) -> JSON:
    """Mean squares of odometry's position errors (m²): jitter and what is left; the same for the model."""
    view = TrueView(settings.scene.camera, Scene(settings.scene))
    frames = [frame for watch in notes.watches for frame in watch.frames]
    held = [frame.pose for frame in frames if frame.pose is not None]
    row: JSON = {
        "frames": len(frames),
        "frames_lost": len(frames) - len(held),
        "points": float(np.median([pose.inliers for pose in held])) if held else 0.0,
    }
    points = max(int(row["points"]), MINIMUM_INLIERS)
    row |= _mean_squares("pixels", [_errors(watch) for watch in notes.watches])
    for name, noise_px, map_px in (("exact", 0.0, 0.0), ("noise", _KNOWN_PX, 0.0), ("map", 0.0, _KNOWN_PX)):
        noise = TrackingNoise(noise_px=noise_px, map_px=map_px, points=points, lost_share=0.0)
        rng = np.random.default_rng(seed)
        row |= _mean_squares(name, [_replay_errors(w, settings, noise, view, rng) for w in notes.watches])
    return row


def _mean_squares(name: str, errors: list[Array]) -> JSON:
    long = [e for e in errors if len(e) > 4]
    return {
        f"{name}_jitter2": float(np.mean([_jitter2(e) for e in long])),
        f"{name}_error2": float(np.mean([(e**2).sum(axis=1).mean() for e in long])),
    }


def _errors(watch: Followed) -> Array:
    """Position errors (n, 3) m in C0 of the frames that odometry held."""
    held = [(frame.shown.view.X_WC, frame.pose.X_C0C) for frame in watch.frames if frame.pose is not None]
    if not held:
        return np.zeros((0, 3))
    X_C0W = se3.inverse(held[0][0])
    return np.array([X_C0C[:3, 3] - (X_C0W @ X_WC)[:3, 3] for X_WC, X_C0C in held])


def _replay_errors(
    watch: Followed, settings: Settings, noise: TrackingNoise, view: TrueView, rng: np.random.Generator
) -> Array:
    """The same of the model, led along the watch's true path."""
    vision = settings.vision
    model = ModelOdometry(watch.camera, vision.odometry, vision.markers.tool, noise, view, rng)
    frames = [f._replace(pose=model.process(f.shown, f.X_CM, 0, k)) for k, f in enumerate(watch.frames)]
    return _errors(watch._replace(frames=frames))


def _jitter2(errors: Array) -> float:
    """Mean square of what changes from frame to frame: the second difference of white noise has six times
    its variance.
    """
    second = errors[:-2] - 2.0 * errors[1:-1] + errors[2:]
    return float((second**2).sum(axis=1).mean() / 6.0)


class MeasuredRow(NamedTuple):
    """One seed in pictures: sums over corners, mean squares of odometry's errors and of the model's."""

    seed: int
    condition: str
    corner_noise2: float
    corner_bias2: float
    corner_places: float
    markers_expected: float
    markers_missed: float
    frames: float
    frames_lost: float
    points: float
    pixels_jitter2: float
    pixels_error2: float
    exact_jitter2: float
    exact_error2: float
    noise_jitter2: float
    noise_error2: float
    map_error2: float
    failure: str
    cpu_s: float


def parameters(rows: Sequence[MeasuredRow]) -> JSON:
    """The model's parameters from the rows of one condition. Raises MeasurementFailed when none is good."""
    good = [row for row in rows if np.isfinite(row.pixels_error2)]
    if not good:
        raise MeasurementFailed("measurement.no_runs", f"eye model: 0 of {len(rows)} runs can be used")

    def mean(column: str) -> float:
        return float(np.mean([getattr(row, column) for row in good]))

    still = mean("exact_jitter2")  # what the camera's true geometry alone makes of a moving camera
    jitter = max(mean("pixels_jitter2") - still, 0.0) / (mean("noise_jitter2") - still)
    noise_px = _KNOWN_PX * jitter**0.5
    floor = mean("exact_error2")
    by_noise = (mean("noise_error2") - floor) * (noise_px / _KNOWN_PX) ** 2
    left = max(mean("pixels_error2") - floor - by_noise, 0.0)
    map_px = _KNOWN_PX * (left / max(mean("map_error2") - floor, 1e-18)) ** 0.5
    places = sum(row.corner_places for row in good)
    bias2 = sum(row.corner_bias2 * row.corner_places for row in good) / places
    return {
        "corners": {
            "noise_px": round(mean("corner_noise2") ** 0.5, 4),
            "bias_px": round(max(bias2, 0.0) ** 0.5, 4),
            "missed_share": round(
                sum(row.markers_missed for row in good) / sum(row.markers_expected for row in good), 5
            ),
        },
        "tracking": {
            "noise_px": round(noise_px, 4),
            "map_px": round(map_px, 4),
            "points": round(mean("points")),
            "lost_share": round(sum(r.frames_lost for r in good) / sum(r.frames for r in good), 5),
        },
    }


class MeasureSettings(NamedTuple):
    """Where the model's parameters go."""

    model_file: Annotated[Path, typer.Option(help="The file to write.")] = Path("configs/eye_model.yaml")


Noted = Finished[MeasureSettings, MeasuredRow]


def measure_tasks(request: CampaignRequest, settings: MeasureSettings) -> list[Task]:
    """The seeds under every condition."""
    return [
        {
            "key": f"{condition}-{seed}",
            "seed": seed,
            "arm": WORLDS[world].arm,
            "world": str(world),
            "condition": condition,
            "assignments": [],
        }
        for condition, world in CONDITIONS.items()
        for seed in seeds(request)
    ]


def _model_parameters(done: Noted) -> JSON:
    """Condition → the model's parameters."""
    return {name: parameters([row for row in done.rows if row.condition == name]) for name in CONDITIONS}


def measure_table(done: Noted) -> list[Table]:
    """All parameters."""
    shown = [
        [condition, part, name, value]
        for condition, parts in _model_parameters(done).items()
        for part, values in parts.items()
        for name, value in values.items()
    ]
    return [table("what pictures do", ["condition", "of", "parameter", "measured"], shown)]


def measure_verdict(done: Noted) -> list[Check]:
    """All conditions could be measured; their parameters are written to the file that was asked for."""
    failed = sum(bool(row.failure) for row in done.rows)
    done.settings.model_file.write_text(
        _text(_model_parameters(done), done.request.seed, done.request.runs), encoding="utf-8"
    )
    return [Check(f"measured, and written to {done.settings.model_file}", f"{failed} runs failed", "", True)]


EYES_MEASURE = Experiment(
    name="eyes-measure",
    title="Measure in rendered pictures what the eye model needs, and write its file.",
    settings=MeasureSettings,
    row=MeasuredRow,
    tasks=measure_tasks,
    run=one_run,
    table=measure_table,
    verdict=measure_verdict,
    figures=_model_parameters,
    runs=8,
    seed=1100,
    world="payload, mount, camera, object, geometry drawn from the seed; the 4 m arm",
    eyes="rendered pictures",
)


def _text(measured: JSON, first_seed: int, runs: int) -> str:
    """The file, with its provenance."""
    today = datetime.date.today().isoformat()
    lines = [
        "# What rendered pictures do to corners and tracked points, for",
        "# testbed/lockstep/simulated_measurements.py, which stands in for them.",
        f"# Provenance: [M] all of it, on {today}: longreach experiment eyes-measure "
        f"--count {runs} --seed {first_seed}",
    ]
    for condition, parts in measured.items():
        lines.append(f"{condition}:")
        for part, values in parts.items():
            pairs = ", ".join(f"{name}: {value}" for name, value in values.items())
            lines.append(f"  {part}: {{{pairs}}} # [M]")
    return "\n".join(lines) + "\n"
