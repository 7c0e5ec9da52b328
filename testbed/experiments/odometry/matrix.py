"""`longreach experiment odometry-matrix`: odometry of recordings on rendered sequences of every kind, beside
ORB-SLAM3 on the same pictures.

What is asked of every pair is the same: right within what was told, or lost by name.
"""

import tempfile
import time
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
import typer
from rich.table import Table

from foundation.configuration import load
from protocol.errors import ConfigurationError, LongreachError
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, at_most, inside, seeds
from testbed.experiments.odometry import orb_slam3
from testbed.experiments.odometry.judging import FREEDOM, gross, judged
from testbed.experiments.odometry.sequences import KINDS, Sequence, sequence
from testbed.reporting.console import table
from testbed.reporting.trajectory_errors import trajectory_errors
from vision_pc.config.vision import RectifiedPairSettings, VisionConfig
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, OdometryPose, StereoPair
from vision_pc.shell.cameras.sequence import SequenceResult, follow_pairs, read_calibration

NEES_BAND = (0.7, 1.5)
_NAN = float("nan")
_WORDS_SEEDS = (3, 4)  # walls that the peer's vocabulary is grown on


class MatrixSettings(NamedTuple):
    """Which kinds, how long, and whether beside the peer."""

    kind: Annotated[list[str], typer.Option(help="Only these kinds; may be given again.")] = []  # noqa: RUF012
    pairs: Annotated[int, typer.Option(help="Pairs of a sequence, over 1.1 m.", min=12, max=600)] = 40
    peer: Annotated[bool, typer.Option(help="ORB-SLAM3 on the same pictures, where it is installed.")] = True


class MatrixRow(NamedTuple):
    """One sequence. ``wrong``: pairs located, but off by more than three standard deviations and a floor.

    ``gross``: off by more than 30 mm, whatever was told. ``nees`` the mean error² over variance; ``peer_``
    of ORB-SLAM3.
    """

    kind: str
    seed: int
    pairs: int
    located: int
    maps: int
    losses: str
    ate_mm: float
    worst_mm: float
    told_mm: float
    wrong: int
    gross: int
    nees: float
    ms: float
    peer_located: float
    peer_ate_mm: float
    peer_worst_mm: float
    peer_gross: float
    peer_ms: float
    failure: str = ""
    cpu_s: float = _NAN


Rows = Finished[MatrixSettings, MatrixRow]


def matrix_tasks(request: CampaignRequest, settings: MatrixSettings) -> list[Task]:
    """Every kind under every seed. Raises ConfigurationError for a kind that there is not."""
    unknown = [name for name in settings.kind if name not in KINDS]
    if unknown:
        raise ConfigurationError(
            "configuration.unknown_kind", f"--kind {unknown[0]}: one of {', '.join(KINDS)} is wanted"
        )
    return [
        {
            "key": f"{name}-{seed}-{settings.pairs}" + ("" if settings.peer else "-alone"),
            "kind": name,
            "seed": seed,
            "pairs": settings.pairs,
            "peer": settings.peer,
        }
        for name in settings.kind or KINDS
        for seed in seeds(request)
    ]


def one_row(config_dir: Path, task: Task) -> MatrixRow:
    """The sequence rendered, followed and judged."""
    cv2.setNumThreads(1)
    config = load(VisionConfig, config_dir / "vision.yaml")
    made = sequence(config_dir, task["kind"], task["seed"], task["pairs"])
    began = time.process_time()
    result, refusal = _followed(config, made, KINDS[task["kind"]].exact)
    ms = 1e3 * (time.process_time() - began) / len(made.pairs)
    told = judged(result, made.X_C0C)
    causes = " ".join(f"{cause} {count}" for cause, count in result.losses.most_common())
    peer = _peer(config_dir, config, made) if task["peer"] and not refusal else _NO_PEER
    return MatrixRow(
        task["kind"],
        task["seed"],
        len(made.pairs),
        told.located,
        len(result.joints),
        refusal or causes,
        _ate_mm(result.poses, made.X_C0C),
        1e3 * told.worst_m,
        1e3 * told.told_m,
        told.wrong,
        told.gross,
        told.nees,
        ms,
        *peer,
    )


def _followed(config: VisionConfig, made: Sequence, exact: bool) -> tuple[SequenceResult, str]:
    """What the command `longreach odometry` makes of the pairs; or the cause for which it refuses them."""
    recorded = config.recorded_odometry
    if exact:  # so told: what `--set vision.recorded_odometry.…` does
        floor = config.odometry.depth_floor_px
        known = {"depth_floor_px": floor, "depth_told_px": floor, "disparity_std_px": 0.0}
        recorded = recorded.model_copy(update=known)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "camera.yaml"
        _write(path, made.told)
        try:
            return follow_pairs(
                lambda: made.pairs,
                lambda pair: SegmentedOdometry(read_calibration(path, pair), config.odometry, recorded),
            ), ""
        except LongreachError as error:
            return SequenceResult([], [], 0), error.cause


def _write(path: Path, told: RectifiedPairSettings) -> None:
    lines = [f"{name}: {value}\n" for name, value in told.model_dump().items() if value is not None]
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
        _write(path, made.told)
        camera: CameraCalibration = read_calibration(path, made.pairs[0])
    found = orb_slam3.follow(camera, _words(config_dir), made.pairs)
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


def _mean(rows: list[MatrixRow], column: str) -> float:
    values = [float(getattr(row, column)) for row in rows]
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else _NAN


def _middle(rows: list[MatrixRow], column: str) -> float:
    known = [value for row in rows if np.isfinite(value := float(getattr(row, column)))]
    return float(np.median(known)) if known else _NAN


def matrix_table(done: Rows) -> list[Table]:
    """A line a kind, over its seeds: medians, but worst errors, counts of pairs, and mean NEES."""
    heads = ["kind", "located", "ATE mm", "worst mm", "σ told mm", "wrong", "NEES/6", "ms a pair"]
    heads += [f"ORB-SLAM3: {name}" for name in ("located", "ATE mm", "worst mm", "> 30 mm", "ms")]
    return [table("odometry of recordings", heads, [_line(name, rows) for name, rows in _by_kind(done)])]


def _line(name: str, rows: list[MatrixRow]) -> list[str]:
    pairs = sum(row.pairs for row in rows)
    peers = [row for row in rows if np.isfinite(row.peer_located)]
    seen = sum(row.pairs for row in peers)
    return [
        KINDS[name].words,
        f"{sum(row.located for row in rows) / pairs:.0%}",
        _number(_middle(rows, "ate_mm")),
        _number(max(row.worst_mm for row in rows)),
        _number(_middle(rows, "told_mm")),
        str(sum(row.wrong for row in rows)),
        _number(_mean(rows, "nees") / FREEDOM),
        _number(_middle(rows, "ms"), 0),
        f"{sum(row.peer_located for row in peers) / seen:.0%}" if seen else "",
        _number(_middle(peers, "peer_ate_mm")),
        _number(max((row.peer_worst_mm for row in peers), default=_NAN)),
        f"{sum(row.peer_gross for row in peers):.0f}" if seen else "",
        _number(_middle(peers, "peer_ms"), 0),
    ]


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def _by_kind(done: Rows) -> list[tuple[str, list[MatrixRow]]]:
    kinds = {name: [row for row in done.rows if row.kind == name and not row.failure] for name in KINDS}
    return [(name, rows) for name, rows in kinds.items() if rows]


def matrix_verdict(done: Rows) -> list[Check]:
    """Nothing wrong and not told; what cannot be used is refused; errors are as large as told."""
    kinds = dict(_by_kind(done))
    usable = [row for name, rows in kinds.items() for row in rows if not KINDS[name].refused]
    useless = [row for name, rows in kinds.items() for row in rows if KINDS[name].refused]
    pairs = sum(row.pairs for row in usable)
    checks = [
        at_most(f"wrong and not told, of {pairs} pairs", sum(row.wrong for row in usable), 0.0),
        at_most("pairs located that nobody can locate", sum(row.located for row in useless), 0.0),
        at_most("runs that failed", sum(bool(row.failure) for row in done.rows), 0.0),
        inside("error² / variance told, over the kinds", _nees(usable), NEES_BAND),
    ]
    if still := kinds.get("still_wall"):
        checks.append(
            at_most("ATE on the still wall, calibration exact", _middle(still, "ate_mm"), 0.1, "mm")
        )
    if known := [row for row in usable if np.isfinite(row.peer_gross)]:
        words = ("off by more than 30 mm", "pairs")
        checks += [
            at_most(f"{words[0]}: Longreach", sum(row.gross for row in known), None, words[1]),
            at_most(f"{words[0]}: ORB-SLAM3", sum(row.peer_gross for row in known), None, words[1]),
        ]
    return checks


def _nees(rows: list[MatrixRow]) -> float:
    """Relative to its expectation; every kind weighs alike."""
    kinds = sorted({row.kind for row in rows})
    return float(np.nanmean([_mean([row for row in rows if row.kind == k], "nees") for k in kinds])) / FREEDOM


def matrix_figures(done: Rows) -> dict[str, Any]:
    """NEES over its expectation by kind."""
    return {"nees": {name: _mean(rows, "nees") / FREEDOM for name, rows in _by_kind(done)}}


ODOMETRY_MATRIX = Experiment(
    name="odometry-matrix",
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
