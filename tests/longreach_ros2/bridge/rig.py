"""Plant, controller and bridge as processes, with a stranger in a ROS domain of their own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from testbed.realtime.launch import CONTROLLER, PLANT
from tests.integration.services import Running, running
from tests.support.paths import CONFIGS, ROOT
from tests.support.patience import PATIENT

PYTHON = ROOT / f"{Path(sys.prefix).name}-ros" / "bin" / "python"
needs_ros = pytest.mark.skipif(
    not (PYTHON.parent.parent / ".stamp").exists(), reason="no ROS 2 here (make ros-peers)"
)
# Of the link and of a stream, on a machine that does other things too; what is timed says its own.
LENIENT = (
    *PATIENT,
    "controller.reference_link.link_timeout_ms=3000",
    "controller.streaming.max_age_ms=1000",
)
_START_S = 60.0


def environment(domain: int) -> dict[str, str]:
    """Discovery on this machine alone, in a domain of its own."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONUNBUFFERED": "1",
    }


class Talk:
    """A stranger's process: its steps are called by their names."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process

    def __getattr__(self, step: str) -> Any:
        def call(**given: Any) -> Any:
            assert self.process.stdin
            assert self.process.stdout
            self.process.stdin.write(json.dumps([step, given]) + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
            assert answer, f"the stranger ended in {step}"
            return json.loads(answer)

        return call


@contextmanager
def stranger(domain: int, *options: str) -> Iterator[Talk]:
    """A stranger in the domain, until the block ends or somebody kills it."""
    command = [str(PYTHON), str(Path(__file__).with_name("stranger.py")), *options]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment(domain), **pipes) as process:
        try:
            yield Talk(process)
        finally:
            process.kill()


class Bridged(NamedTuple):
    """A stranger beside a bridge, and the bridge's process; the plant's records, if there are any."""

    talk: Talk
    process: "subprocess.Popen[str]"
    records: Path


@contextmanager
def bridged(
    directory: Path, domain: int, silence_ms: float = 1000.0, recorded: bool = False
) -> Iterator[Bridged]:
    """A stranger beside plant, controller and the bridge that drives, with its camera."""
    settings = (*LENIENT, f"controller.streaming.silence_ms={silence_ms}")
    with running(directory, *settings, only=(PLANT, CONTROLLER), recorded=recorded) as rig:
        vision = rig.launch.settings.vision
        options = ["--controller", f"{vision.link.host}:{vision.link.port}", "--camera"]
        options += ["--set", f"vision.camera.stream.port={vision.camera.stream.port}"]
        with beside(directory, domain, options) as (talk, bridge):
            yield Bridged(talk, bridge, rig.launch.records(PLANT))


@contextmanager
def watched(directory: Path, domain: int) -> Iterator[tuple[Talk, Running]]:
    """A stranger beside all three services and the bridge that watches them; vision's pictures are shown."""
    with ExitStack() as stack:
        raw = "vision.recording.images=raw"
        rig = stack.enter_context(running(directory, raw, *PATIENT, foxglove=0))
        options = ["--watch", f"ws://127.0.0.1:{rig.launch.foxglove}"]
        talk, _ = stack.enter_context(beside(directory, domain, options))
        yield talk, rig


@contextmanager
def in_lockstep(directory: Path, domain: int) -> Iterator[Talk]:
    """A stranger that follows the /clock of a bridge in lockstep, as fast as it is computed."""
    options = ["--lockstep", "--pace", "0"]
    with beside(directory, domain, options, "--ros-args", "-p", "use_sim_time:=true") as (talk, _):
        yield talk


@contextmanager
def beside(
    directory: Path, domain: int, options: list[str], *for_stranger: str
) -> Iterator[tuple[Talk, "subprocess.Popen[str]"]]:
    """A stranger, and a bridge with these options that publishes joint states."""
    log = directory / "bridge.log"
    command = [str(PYTHON), "-m", "longreach_ros2", *options, "--config-dir", str(CONFIGS)]
    with (
        log.open("w") as stderr,
        subprocess.Popen(
            command, env=environment(domain), cwd=ROOT, stdout=subprocess.PIPE, stderr=stderr, text=True
        ) as bridge,
    ):
        try:
            assert bridge.stdout is not None
            assert '"ready"' in bridge.stdout.readline(), log.read_text()
            with stranger(domain, *for_stranger) as talk:
                assert talk.wait(within_s=_START_S), log.read_text()
                yield talk, bridge
        finally:
            ended(bridge)


def ended(process: "subprocess.Popen[str]") -> None:
    """End a bridge in good order, unless somebody has killed it."""
    if process.poll() is None:
        process.terminate()
        assert process.wait(20.0) == 0


def enable(talk: Talk, within_s: float = 20.0) -> None:
    """Enable the arm; it is refused while services that have just started still find each other."""
    until_s = time.monotonic() + within_s
    while not (answer := talk.service(name="enable"))[0]:
        assert time.monotonic() < until_s, answer
        time.sleep(0.3)


def at_rest(talk: Talk, within_s: float = 20.0) -> list[float]:
    """The joints once they stand still."""
    end_s, before = time.monotonic() + within_s, talk.joints()
    while True:
        time.sleep(0.3)
        q = talk.joints()
        if max(abs(a - b) for a, b in zip(q, before, strict=True)) < 2e-4:
            return q
        assert time.monotonic() < end_s, "the arm does not come to rest"
        before = q
