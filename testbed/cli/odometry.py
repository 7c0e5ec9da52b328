"""`longreach odometry`: the camera's path through a recorded sequence of rectified pairs."""

import time
from pathlib import Path

from foundation.configuration import load, parse_overrides
from testbed.reporting.console import bars, out, write_json
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import OdometryPose
from vision_pc.shell.cameras.sequence import count_pairs, follow, write_tum


def run_odometry(
    config_dir: Path,
    left: Path,
    right: Path,
    calibration: Path,
    rate_hz: float,
    trajectory: Path,
    settings: list[str],
    json_file: Path | None,
) -> bool:
    """Whether every pair was located; the path is in ``trajectory`` in TUM's form, pairs lost left out."""
    config = load(VisionConfig, config_dir / "vision.yaml", parse_overrides(settings).get("vision"))
    count = count_pairs(left)
    with bars() as shown, shown.step("following the camera") as bar:

        def report(index: int, pose: OdometryPose | None) -> None:
            held = "lost" if pose is None else f"{pose.inliers} points"
            bar.update((index + 1) / count, f"pair {index + 1} of {count}: {held}")

        began = time.process_time()
        outcome = follow(left, right, calibration, config.odometry, rate_hz, report)
        spent_ms = 1e3 * (time.process_time() - began) / outcome.frames
    write_tum(trajectory, outcome.poses)
    lost = f"{outcome.lost} lost, last for {outcome.last_loss}" if outcome.lost else "none lost"
    out.print(
        f"{outcome.frames} pairs, {lost}; {outcome.keyframes} keyframes; {spent_ms:.1f} ms a pair;"
        f" {trajectory} holds {len(outcome.poses)} poses"
    )
    figures = {
        "pairs": outcome.frames,
        "lost": outcome.lost,
        "last_loss": outcome.last_loss,
        "keyframes": outcome.keyframes,
        "milliseconds_a_pair": spent_ms,
        "trajectory": trajectory,
    }
    write_json(json_file, figures)
    return outcome.lost == 0
