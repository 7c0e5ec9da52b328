"""Odometry on a real drive and in a real room: all is located, drift and time are small, and σ covers."""

import time

import numpy as np
import pytest

from protocol.errors import RequestRefused
from testbed.reporting.trajectory_errors import trajectory_errors
from tests.support.recorded_drives import Sequence, followed, judged, sequence
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.cameras.sequence import SequenceResult


def shown(name: str) -> Sequence:
    try:
        return sequence(name)
    except RequestRefused as refusal:
        pytest.skip(str(refusal))


def drift_percent(result: SequenceResult, of: Sequence) -> float:
    times = np.array([pair.capture_ns / 1e9 for pair in of.pairs])
    drift = trajectory_errors(result.poses, times, of.true, of.name).drift_percent
    assert drift is not None
    return drift


def test_a_drives_cut_is_located_and_covered(config: VisionConfig) -> None:
    """ORB-SLAM3 locates all twelve."""
    drive = shown("drive").chosen(slice(20, 32))
    result = followed(drive, config)
    assert result.lost == 0, result.losses
    assert drift_percent(result, drive) < 0.78
    found = judged(result, drive)
    assert found.within == found.poses


@pytest.mark.slow("95 pictures of 0.36 megapixels")
def test_a_room_is_followed_to_less_than_its_truth_is_known(config: VisionConfig) -> None:
    room = shown("room")
    begun = time.process_time()
    result = followed(room, config)
    print(f"room: {1e3 * (time.process_time() - begun) / len(room.pairs):.1f} ms of processor time a pair")
    assert result.lost == 0, result.losses
    times = np.array([pair.capture_ns / 1e9 for pair in room.pairs])
    assert trajectory_errors(result.poses, times, room.true, "room").ate_mm < 0.96  # ORB-SLAM3's
    found = judged(result, room)
    assert found.within == found.poses
