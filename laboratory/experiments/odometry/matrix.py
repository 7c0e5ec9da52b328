"""`longreach experiment odometry`: odometry of recordings on rendered sequences of every kind, beside
ORB-SLAM3 on the same pictures.

What is asked of every pair is the same: right within what was predicted, or lost by name.
"""

import tempfile
import time
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from foundation.configuration import load
from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Experiment, seeds
from laboratory.experiments.odometry import orb_slam3
from laboratory.experiments.odometry.open_worlds import OPEN_KINDS, open_sequence
from laboratory.experiments.odometry.real_sequences import REAL_KINDS, available, real_sequence
from laboratory.experiments.odometry.sequences import KINDS, Sequence, sequence
from laboratory.experiments.odometry.verdict import (
    MatrixRow,
    MatrixSettings,
    gross,
    judged,
    matrix_figures,
    matrix_table,
    matrix_verdict,
)
from protocol.errors import ConfigurationError, LongreachError
from testbed.reporting.console import out
from testbed.reporting.trajectory_errors import trajectory_errors
from vision_pc.config.vision import RectifiedPairSettings, VisionConfig
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, StereoPair
from vision_pc.shell.cameras.sequence import SequenceResult, follow_pairs
from vision_pc.shell.cameras.sequence_calibration import recorded_camera

_NAN = float("nan")
_EVERY = (*KINDS, *OPEN_KINDS, *REAL_KINDS)
_WORDS_SEEDS = (3, 4)  # walls that the peer's vocabulary is grown on


def matrix_tasks(request: CampaignRequest, settings: MatrixSettings) -> list[Task]:
    """Every kind under every seed, and every real one that is there.

    Raises ConfigurationError for a kind that there is not.
    """
    unknown = [name for name in settings.kind if name not in _EVERY]
    if unknown:
        every = ", ".join(_EVERY)
        raise ConfigurationError(
            "configuration.unknown_kind", f"--kind {unknown[0]}: one of {every} is wanted"
        )
    chosen = settings.kind or _EVERY
    real = [name for name in chosen if name in REAL_KINDS and settings.real]
    if real and not available():
        out.print("real pictures are left out: LONGREACH_DATA names no directory with them", style="yellow")
        real = []
    return [
        {
            "key": f"{name}-{seed}-{settings.pairs}" + ("" if settings.peer else "-alone"),
            "kind": name,
            "seed": seed,
            "pairs": settings.pairs,
            "peer": settings.peer,
        }
        for name in chosen
        if name not in REAL_KINDS
        for seed in seeds(request)
    ] + [
        {"key": name if settings.peer else f"{name}-alone", "kind": name, "seed": 0, "peer": settings.peer}
        for name in real
    ]


def one_row(config_dir: Path, task: Task) -> MatrixRow:
    """The sequence rendered, or read, followed and judged."""
    cv2.setNumThreads(1)
    config = load(VisionConfig, config_dir / "vision.yaml")
    name = task["kind"]
    made = _sequence_of(config_dir, task)
    began = time.process_time()
    result, refusal = _follow(config, made, name in KINDS and KINDS[name].exact)
    ms = 1e3 * (time.process_time() - began) / len(made.pairs)
    judgement = judged(result, made.X_C0C)
    causes = " ".join(f"{cause} {count}" for cause, count in result.losses.most_common())
    peer = _peer(config_dir, config, made) if task["peer"] and not refusal else _NO_PEER
    return MatrixRow(
        name,
        task["seed"],
        len(made.pairs),
        judgement.located,
        len(result.joints),
        refusal or causes,
        _ate_mm(result.poses, made.X_C0C),
        1e3 * judgement.worst_m,
        1e3 * judgement.predicted_m,
        judgement.wrong,
        judgement.gross,
        judgement.nees,
        ms,
        *peer,
    )


def _sequence_of(config_dir: Path, task: Task) -> Sequence:
    name = task["kind"]
    if name in REAL_KINDS:
        return real_sequence(name)
    if name in OPEN_KINDS:
        return open_sequence(name, task["seed"], task["pairs"])
    return sequence(config_dir, name, task["seed"], task["pairs"])


def _follow(config: VisionConfig, made: Sequence, exact: bool) -> tuple[SequenceResult, str]:
    """What the command `longreach odometry` makes of the pairs; or the cause for which it refuses them."""
    settings = config.odometry if exact else config.odometry_of_recordings
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "camera.yaml"
        _write(path, made.stated)
        try:
            return follow_pairs(
                lambda: made.pairs,
                lambda pair: SegmentedOdometry(recorded_camera(path, pair).camera, settings),
                tool_at=lambda pair: made.arm.get(pair.frame_id),
            ), ""
        except LongreachError as error:
            return SequenceResult([], [], 0), error.cause


def _write(path: Path, stated: RectifiedPairSettings) -> None:
    lines = [f"{name}: {value}\n" for name, value in stated.model_dump().items() if value is not None]
    path.write_text("".join(lines), encoding="ascii")


def _ate_mm(poses: list[OdometryPose], true: Array) -> float:
    """NaN where fewer than three poses are."""
    if len(poses) < 3:
        return _NAN
    times = np.array([pose.capture_ns / 1e9 for pose in poses])
    return trajectory_errors(poses, times, true[[pose.frame_id for pose in poses]], "rendered").ate_mm


class _Peer(NamedTuple):
    located: float
    ate_mm: float
    worst_mm: float
    gross: float
    ms: float


_NO_PEER = _Peer(*[_NAN] * 5)


def _peer(config_dir: Path, config: VisionConfig, made: Sequence) -> _Peer:
    if not orb_slam3.installed():
        return _NO_PEER
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "camera.yaml"
        _write(path, made.stated)
        camera: CameraCalibration = recorded_camera(path, made.pairs[0]).camera
    found = orb_slam3.follow_apart(camera, _words(config_dir), made.pairs)
    off, worst = gross([(pose.frame_id, pose.X_C0C) for pose in found.poses], made.X_C0C)
    return _Peer(
        len(found.poses),
        _ate_mm(
            [pose._replace(capture_ns=made.pairs[pose.frame_id].capture_ns) for pose in found.poses],
            made.X_C0C,
        ),
        1e3 * worst,
        off,
        1e3 * float(np.median(found.spent_s)),
    )


@lru_cache(maxsize=1)
def _words(config_dir: Path) -> Path:
    """The peer's vocabulary, grown on walls that are not followed; kept for the rows of this process."""
    path = Path(tempfile.mkdtemp(prefix="longreach-orb-")) / "words.txt"
    pairs: list[StereoPair] = []
    for seed in _WORDS_SEEDS:
        pairs += sequence(config_dir, "depth_steps", seed, 12).pairs[::3]
    orb_slam3.vocabulary([pair.left for pair in pairs], path)
    return path


ODOMETRY = Experiment(
    name="odometry",
    title="Odometry of recordings on rendered sequences of every kind, beside ORB-SLAM3.",
    settings=MatrixSettings,
    row=MatrixRow,
    tasks=matrix_tasks,
    run=one_row,
    table=matrix_table,
    verdict=matrix_verdict,
    figures=matrix_figures,
    runs=4,
    seed=1200,
    world="way, wall, its distance and what rectification leaves drawn from the seed",
    eyes="rendered pictures",
    workers=1,
)
