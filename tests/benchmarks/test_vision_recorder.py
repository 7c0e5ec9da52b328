"""What vision's recording costs: where it is told, in all, on the disk; beside it the pictures as PNG."""

import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from foundation.configuration import load
from foundation.recording.messages import DirectRecording
from tests.support.paths import CONFIGS
from vision_pc.config.vision import VisionConfig
from vision_pc.core.types import FrameObservation, MarkerObservation, OdometryPose, PointPairs, StereoPair
from vision_pc.shell.recording.vision_messages import ToldWithFrame
from vision_pc.shell.recording.vision_recorder import VisionRecorder

CONFIG = load(VisionConfig, CONFIGS / "vision.yaml")
RATE_HZ = 10.0
SECONDS = 6
FRAMES = round(SECONDS * RATE_HZ)
LIMITS = {"none": 0.1, "jpeg": 0.3, "raw": 0.6}  # of what both eyes take as PNG


def frames() -> list[StereoPair]:
    """Pairs with the camera's noise of 2 grey levels over a wall."""
    generator = np.random.default_rng(1)
    wall = cv2.resize(generator.integers(60, 200, (90, 160)).astype(np.uint8), (1280, 720))
    pairs = []
    for number in range(6):
        eyes = (
            np.clip(wall + np.round(generator.normal(0.0, 2.0, wall.shape)), 0, 255).astype(np.uint8)
            for _ in range(2)
        )
        pairs.append(StereoPair(*eyes, 0, number))
    return pairs


def measured(pair: StereoPair) -> tuple[FrameObservation, OdometryPose]:
    """A frame that shows four markers and 300 points."""
    corners = np.arange(8.0).reshape(4, 2)
    markers = tuple(
        MarkerObservation(n, 0.1, corners, corners, np.eye(4), np.eye(6), 0.1, 20.0) for n in range(4)
    )
    poses: dict[str, Any] = dict.fromkeys(("X_CM", "X_CO"), np.eye(4))
    poses |= dict.fromkeys(("cov_CM", "bias_CM", "cov_CO", "bias_CO"), np.eye(6))
    seen = FrameObservation(
        pair.capture_ns, pair.frame_id, markers=markers, rejected={}, offset=None, **poses
    )
    points = PointPairs(np.zeros((300, 2)), np.ones((300, 2)))
    pose = OdometryPose(pair.capture_ns, pair.frame_id, np.eye(4), np.eye(6), 300, 0.5, 0.1, points)
    return seen, pose


@pytest.mark.bench
@pytest.mark.parametrize("images", ["none", "jpeg", "raw"])
def test_recording_costs_little_of_a_core(tmp_path: Path, images: str) -> None:
    recording = CONFIG.recording.model_copy(update={"images": images})
    config = CONFIG.model_copy(update={"recording": recording})
    kept = frames()

    def record(made: Any) -> tuple[float, float]:
        """CPU seconds of this thread while told, and of the process until the file is closed."""
        path = tmp_path / f"{made.__name__ if made else 'thread'}.mcap"
        more = {"made": made} if made else {}
        recorder = VisionRecorder(path, config, {}, {}, time.monotonic_ns, **more)
        began_s, told_s = time.process_time(), 0.0
        for number in range(FRAMES):
            stamp = {"capture_ns": round(number * 1e9 / RATE_HZ), "frame_id": number}
            pair = kept[number % len(kept)]._replace(**stamp)
            seen, pose = measured(pair)
            tick_s = time.thread_time()
            recorder.observed(pair, None, seen)
            recorder.tracked(1, pair, ToldWithFrame(False, None), pose)
            told_s += time.thread_time() - tick_s
        recorder.close()
        return told_s, time.process_time() - began_s

    told_s, _ = record(None)
    _, whole_s = record(DirectRecording)
    began_s = time.process_time()
    for pair in kept:
        for eye in (pair.left, pair.right):
            cv2.imencode(".png", eye, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    png_percent = 100.0 * RATE_HZ * (time.process_time() - began_s) / len(kept)
    png_us = 1e4 * png_percent / RATE_HZ
    percent = 100.0 * whole_s / SECONDS
    mb = (tmp_path / "DirectRecording.mcap").stat().st_size * 60e-6 / SECONDS
    told_us = 1e6 * told_s / FRAMES
    print(f"\n{images}: {told_us:.0f} us a frame where it is told, {percent:.1f} % of a core in all,")
    print(f"{mb:.1f} MB/min; its peer, both eyes as PNG: {png_percent:.0f} % of a core")
    assert percent < LIMITS[images] * png_percent
    assert told_us < 0.05 * png_us
