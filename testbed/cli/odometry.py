"""`longreach odometry`: the camera's path through a recorded sequence of rectified pairs."""

import time
from pathlib import Path
from typing import NamedTuple

from foundation.configuration import load, parse_overrides
from testbed.cli.options import OdometryOptions
from testbed.reporting.console import bars, out, write_json
from testbed.reporting.trajectory_errors import TrajectoryErrors, read_tum, trajectory_errors
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.cameras.sequence import (
    PairRecord,
    SequenceResult,
    count_pairs,
    follow,
    write_side_file,
    write_tum,
)


class OdometryRequest(NamedTuple):
    """Two directories of pictures, their calibration, where the path goes, and the truth if it is known."""

    config_dir: Path
    left: Path
    right: Path
    calibration: Path
    options: OdometryOptions
    settings: list[str]


def run_odometry(request: OdometryRequest, json_file: Path | None) -> bool:
    """Whether every pair was located in one map. The path is in ``trajectory`` in TUM's form, pairs lost left
    out; beside it ``.csv`` has a line a pair, and each map apart has a trajectory of its own.
    """
    overrides = parse_overrides(request.settings).get("vision")
    config = load(VisionConfig, request.config_dir / "vision.yaml", overrides)
    truth = None if request.options.truth is None else read_tum(request.options.truth)
    count = count_pairs(request.left)
    with bars() as shown, shown.step("following the camera") as bar:

        def report(record: PairRecord) -> None:
            held = "lost" if record.pose is None else f"{record.pose.inliers} points"
            bar.update((record.frame_id + 1) / count, f"pair {record.frame_id + 1} of {count}: {held}")

        began = time.process_time()
        result = follow(
            request.left, request.right, request.calibration, config, request.options.rate_hz, report
        )
        spent_ms = 1e3 * (time.process_time() - began) / len(result.records)
    files = _written(request.options.trajectory, result)
    _print(result, spent_ms, files)
    figures: dict[str, object] = {
        "pairs": len(result.records),
        "lost": result.lost,
        "losses": dict(result.losses),
        "maps": len(result.joints),
        "maps_apart": len(result.apart),
        "keyframes": result.keyframes,
        "readout_share": result.readout_share,
        "milliseconds_a_pair": spent_ms,
        "trajectories": [str(path) for path in files],
    }
    if truth is not None:
        errors = trajectory_errors(result.poses, *truth, str(request.options.truth))
        _print_errors(errors)
        figures["truth"] = errors._asdict()
    write_json(json_file, figures)
    return result.lost == 0 and not result.apart


def _written(trajectory: Path, result: SequenceResult) -> list[Path]:
    """The files of all trajectories: that of the first map, then one for each that is apart."""
    write_side_file(trajectory.with_suffix(".csv"), result)
    files = [trajectory] + [
        trajectory.with_name(f"{trajectory.stem}.map{k}{trajectory.suffix}") for k in result.apart
    ]
    for path, k in zip(files, [0, *result.apart], strict=True):
        write_tum(path, result.poses_of(k))
    return files


def _print(result: SequenceResult, spent_ms: float, files: list[Path]) -> None:
    causes = ", ".join(f"{cause} {count}" for cause, count in result.losses.most_common())
    lost = f"{result.lost} lost ({causes})" if result.lost else "none lost"
    out.print(
        f"{len(result.records)} pairs, {lost}; {result.keyframes} keyframes; {spent_ms:.1f} ms a pair;"
        f" {files[0]} holds {len(result.poses)} poses"
    )
    if result.readout_share:
        out.print(
            f"the shutter rolls: rows are read over {100.0 * result.readout_share:.0f} % of the time between"
            " pairs; taken out"
        )
    for path, k in zip(files[1:], result.apart, strict=True):
        first = next(record for record in result.records if record.segment == k)
        out.print(
            f"map {k} begins at pair {first.frame_id + 1} after a gap of unknown length and was never joined:"
            f" {len(result.poses_of(k))} poses from its own first pair are in {path}"
        )


def _print_errors(errors: TrajectoryErrors) -> None:
    drift = "" if errors.drift_percent is None else f", drift {errors.drift_percent:.2f} %"
    out.print(
        f"against the truth, {errors.poses} poses over {errors.length_m:.2f} m: ATE {errors.ate_mm:.2f} mm,"
        f" RPE {errors.rpe_mm:.2f} mm {errors.rpe_deg:.4f} deg a pair, scale {errors.scale:.4f}{drift}"
    )
