"""Three processes by the plant's clock, twice from one seed: the recordings are the same, bit for bit."""

from pathlib import Path
from typing import Any

import httpx
import pytest
from mcap.reader import make_reader

from foundation.recording.messages import fields_of
from testbed.choices import Timing
from testbed.realtime.launch import CONTROLLER, PLANT, VISION, prepare
from testbed.realtime.supervisor import supervised
from testbed.scenarios.scenario import chosen_overrides
from tests.support.crash_trials import until_healthy
from tests.support.paths import CONFIGS

ON_REQUEST = Timing(pace=0.0, goes="on_request")
# Numbers of commands are drawn anew in each session, and stand in these; the wall's time is the wall's.
NUMBERED = ("state", "controller/log", "reference", "vision/log", "wall")
DRAWN = {"session", "id", "command_id", "motion_id"}


def driven(directory: Path) -> dict[str, list[Any]]:
    """The messages by topic of a run with a look and a motion that odometry watches."""
    overrides = chosen_overrides(CONFIGS, "standard", 3, [])
    launch = prepare(CONFIGS, overrides, directory, any_ports=True, timing=ON_REQUEST)
    with (
        supervised(launch.services, directory),
        httpx.Client(base_url=launch.rest_url, timeout=300.0) as face,
    ):
        until_healthy(face)
        for path in ("/enable", "/operations/orientation-adjustment", "/operations/look"):
            answer = face.post(path, headers={"Prefer": "wait=300"})
            assert answer.is_success, answer.text
        held_ns = [face.get("/clock").json()["time_ns"] for _ in range(2)]
        assert held_ns[0] == held_ns[1], "no time passes between requests"
    return {
        topic: told
        for name in (PLANT, CONTROLLER, VISION)
        for path in launch.records(name).glob("*.mcap")
        for topic, told in messages(path, held_ns[0]).items()
    }


def messages(path: Path, until_ns: int) -> dict[str, list[Any]]:
    """Those by topic until the last request was answered: the end goes by the wall."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if message.log_time > until_ns:
                continue
            told = plain(message.data) if channel.topic == "/vision/event" else message.data
            found.setdefault(f"{path.stem}{channel.topic}", []).append((message.log_time, told))
    return found


def plain(data: bytes) -> dict[str, Any]:
    """An event of the log without what is drawn anew."""
    return {name: value for name, value in fields_of(data).items() if name not in DRAWN}


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, list[Any]]]:
    return [driven(tmp_path_factory.mktemp(name)) for name in ("first", "second")]


@pytest.mark.processes
@pytest.mark.slow("three services, twice")
def test_two_runs_are_the_same_bit_for_bit(twice: list[dict[str, list[Any]]]) -> None:
    first, second = twice
    assert first.keys() == second.keys()
    compared = [topic for topic in first if not topic.endswith(NUMBERED)]
    assert sum(len(first[topic]) for topic in compared) > 1000
    for topic in compared:
        assert len(first[topic]) == len(second[topic]), topic
        for one, other in zip(first[topic], second[topic], strict=True):
            assert one == other, topic
