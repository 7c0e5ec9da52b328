"""Real ROS 2 beside a machine in lockstep: a stranger with ``use_sim_time`` has the machine's time."""

import time
from collections.abc import Iterator

import numpy as np
import pytest

from tests.longreach_ros2.bridge.rig import Talk, at_rest, enable, in_lockstep, needs_ros

pytestmark = [pytest.mark.realtime, needs_ros]
DOMAIN = 66
TICK_S = 0.1  # the stranger's timer
SUCCEEDED, ABORTED = 4, 6  # of action_msgs/GoalStatus
WAY = np.array([0.06, 0.03, -0.04, 0.05, -0.05, 0.06])
STILL = [0.0] * 6


@pytest.fixture(scope="module")
def talk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Talk]:
    with in_lockstep(tmp_path_factory.mktemp("lockstep"), DOMAIN) as talk:
        yield talk


@pytest.mark.slow("two processes start")
def test_a_strangers_timer_follows_the_machines_time_and_stands_while_it_stands(talk: Talk) -> None:
    before_s, ticks = talk.passed()
    while (now := talk.passed())[0] < before_s + 3.0:
        time.sleep(0.05)
    came, due = now[1] - ticks, (now[0] - before_s) / TICK_S
    assert 0.7 * due < came < due + 2.0, "ROS leaves out what a busy machine is late for"
    assert talk.pause(paused=True)
    time.sleep(0.5)
    stands = talk.passed()
    time.sleep(2.0)
    assert talk.passed() == stands
    assert talk.pause(paused=False)
    while talk.passed()[0] < stands[0] + 1.0:
        time.sleep(0.05)


@pytest.mark.slow("the arm moves for 20 s of its time")
def test_a_trajectory_takes_its_time_on_the_machines_clock(talk: Talk) -> None:
    enable(talk)
    target = np.array(talk.joints()) + WAY
    before_s, real_s = talk.passed()[0], time.monotonic()
    points = [{"t": 20.0, "q": target.tolist(), "v": STILL}]
    assert talk.follow(points=points) == [SUCCEEDED, 0, ""]
    took_s = talk.passed()[0] - before_s
    print(f"{took_s:.1f} s of its time in {time.monotonic() - real_s:.1f} s")
    assert 20.0 < took_s < 40.0
    assert 1e3 * np.abs(np.array(at_rest(talk)) - target).max() < 1.0


@pytest.mark.slow("real processes, and the arm moves")
def test_stamps_are_of_the_machines_time_and_not_of_the_wall_clock(talk: Talk) -> None:
    talk.service(name="enable")
    here = [{"t": 2.0, "q": at_rest(talk), "v": STILL}]
    status, code, text = talk.follow(points=here, stamp_s=time.time())
    assert (status, code) == (ABORTED, -3)
    assert text.startswith("refused.ros_stamp")
    tool = talk.tool()
    tool[1] -= 0.05
    latest_s = talk.passed()[0] + 60.0  # again and again: on a busy machine a stamp is too old
    while talk.tool()[1] != pytest.approx(tool[1], abs=3e-3):
        assert talk.passed()[0] < latest_s, talk.status()
        talk.publish(topic="/longreach/target", pose=tool)
        time.sleep(3.0)
