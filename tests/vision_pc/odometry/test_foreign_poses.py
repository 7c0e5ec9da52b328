"""Poses of somebody else's SLAM in place of our odometry: used as they are, or refused by name."""

import itertools
import socket
import time
from collections.abc import Iterable

import numpy as np
import pytest

from foundation.event_log import EventLog
from protocol.errors import ConfigurationError, MeasurementFailed
from vision_pc.config.vision import PoseFeedSettings
from vision_pc.core import se3
from vision_pc.core.odometry.foreign_poses import ForeignOdometry, TimedPose
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoPair
from vision_pc.shell.pose_feed import UdpPoseFeed, pose_of

MS = 1_000_000
WORLD = se3.transform(se3.exp_so3([0.4, -1.0, 0.2]), (7.0, -3.0, 2.0))  # the SLAM's own
X_TC = se3.transform(se3.exp_so3([0.0, 1.2, 0.0]), (0.3, 0.1, -0.2))
SETTINGS = PoseFeedSettings()


def tool(time_s: float) -> Array:
    return se3.transform(se3.exp_so3([0.0, 0.0, 0.02 * time_s]), (1.0 + 0.15 * time_s, 0.05 * time_s, 0.5))


def posed(times_ms: Iterable[float], scale: float = 1.0, late_ms: float = 40.0) -> list[TimedPose]:
    poses = []
    for at_ms in times_ms:
        X = tool(1e-3 * at_ms) @ X_TC
        X_WC = WORLD @ se3.transform(X[:3, :3], scale * X[:3, 3])
        poses.append(TimedPose(round(at_ms * MS), X_WC, round((at_ms + late_ms) * MS)))
    return poses


class RecordedFeed:
    """A feed that has all from the beginning, up to half a second after what is asked."""

    def __init__(self, poses: list[TimedPose]) -> None:
        self._poses = poses

    def poses_to(self, time_ns: int) -> tuple[TimedPose, ...]:
        return tuple(pose for pose in self._poses if pose.time_ns <= time_ns + 500 * MS)


def followed(poses: list[TimedPose], at_ms: Iterable[float]) -> tuple[list[Array | None], ForeignOdometry]:
    odometry = ForeignOdometry(RecordedFeed(poses), SETTINGS)
    empty = np.zeros((2, 2), dtype=np.uint8)
    found = []
    for number, ms in enumerate(at_ms):
        pose = odometry.process(StereoPair(empty, empty, round(ms * MS), number), None, tool(1e-3 * ms))
        found.append(None if pose is None else pose.X_C0C)
    return found, odometry


def test_between_poses_the_path_since_the_first_pair_is_right_in_any_world() -> None:
    at_ms = np.arange(33.0, 2000.0, 100.0)
    found, _ = followed(posed(np.arange(0.0, 2600.0, 50.0)), at_ms)
    first = tool(0.033) @ X_TC
    for ms, X in zip(at_ms, found, strict=True):
        assert X is not None
        assert pytest.approx(se3.inverse(first) @ tool(1e-3 * ms) @ X_TC, abs=1e-6) == X


def test_a_gap_and_a_feed_that_stops_cost_their_pairs_by_name() -> None:
    times = [*np.arange(0.0, 500.0, 50.0), *np.arange(900.0, 1300.0, 50.0)]
    found, odometry = followed(posed(times), [100.0, 700.0, 1000.0])
    assert [X is not None for X in found] == [True, False, True]
    found, odometry = followed(posed(times), [100.0, 700.0])
    assert odometry.last_loss == "feed_gap"
    found, odometry = followed(posed(times), [1200.0, 2000.0])
    assert (found[1], odometry.last_loss) == (None, "feed_silent")


def jumped() -> list[TimedPose]:
    poses = posed(np.arange(0.0, 2600.0, 50.0))
    there = se3.transform(np.eye(3), (0.4, 0.0, 0.0))
    return [p if p.time_ns < 1000 * MS else p._replace(X_WC=there @ p.X_WC) for p in poses]


@pytest.mark.parametrize(
    ("poses", "cause"),
    [
        (jumped(), "measurement.odometry_jump"),
        (posed(np.arange(0.0, 2600.0, 50.0), scale=1.2), "measurement.odometry_scale"),
        (posed(np.arange(0.0, 2600.0, 50.0), scale=0.001), "measurement.odometry_scale"),
        (posed(np.arange(0.0, 2600.0, 50.0), late_ms=3.6e6), "measurement.odometry_clock"),
    ],
    ids=["jump", "scale", "kilometres", "clock"],
)
def test_another_map_another_unit_and_another_clock_end_the_watch(poses: list[TimedPose], cause: str) -> None:
    with pytest.raises(MeasurementFailed) as refused:
        followed(poses, np.arange(100.0, 2000.0, 100.0))
    assert refused.value.cause == cause


def test_a_jump_before_the_first_pair_does_no_harm() -> None:
    found, _ = followed(jumped(), [1500.0, 1600.0])
    assert all(X is not None for X in found)


def test_lines_that_are_no_pose_are_refused_with_what_is_wanted() -> None:
    at_s, X = pose_of("1795883374.25 1 2 3 0 0 0.7071068 0.7071068")
    assert at_s == 1795883374.25
    assert X[:3, 3] == pytest.approx([1, 2, 3])
    for line in ("1 2 3", "1 2 3 4 0 0 0 nan", "1 2 3 4 0 0 0 0", "x y z 1 2 3 4 5"):
        with pytest.raises(ValueError, match=r"eight finite|unit|no finite number"):
            pose_of(line)


@pytest.mark.realtime
def test_the_feed_hears_udp_waits_for_a_pose_and_leaves_out_what_is_none() -> None:
    said: list[str] = []
    log = EventLog("vision_pc", open("/dev/null", "w"))  # noqa: SIM115
    log.listener = lambda event, level, fields: said.append(fields["cause"])
    feed = UdpPoseFeed(SETTINGS.model_copy(update={"port": 0, "wait_ms": 500.0}), log)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        begin_s = time.time()
        lines = [f"{begin_s + 0.01 * k:.6f} {k} 0 0 0 0 0 1" for k in range(3)]
        for line in (*lines, lines[0], "nonsense", "# a comment"):
            sender.sendto(line.encode(), ("127.0.0.1", feed.port))
        now_ns = time.monotonic_ns() - round(1e9 * (time.time() - begin_s))
        poses = feed.poses_to(now_ns + 20 * MS - MS)
        assert [pose.X_WC[0, 3] for pose in poses] == [0.0, 1.0, 2.0]
        assert [abs(b.time_ns - a.time_ns - 10 * MS) < MS for a, b in itertools.pairwise(poses)] == [True] * 2
        waited_s = time.monotonic()
        feed.poses_to(now_ns + 10**10)
        assert time.monotonic() - waited_s >= 0.45
        assert feed.refused == 2
        assert said == ["feed.bad_pose"]
        with pytest.raises(ConfigurationError, match="odometry_feed"):
            UdpPoseFeed(SETTINGS.model_copy(update={"port": feed.port}), log)
    finally:
        sender.close()
        feed.close()
