"""The containers themselves, where an engine runs: the blocks of the pages, crashes, tokens, the suites."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import httpx
import numpy as np
import pytest

from plant_emulator.core.truth import tool_error
from testbed.realtime.launch import free_port
from testbed.recordings.plant_truth import read_truth
from tests.support.crash_trials import Rig, judge, trials, until_healthy
from tests.support.page_runner import blocks, documents, judge_rest_block, pasted, refusals, shell_blocks
from tests.support.paths import ROOT

pytestmark = [pytest.mark.docker, pytest.mark.timeout(1800)]

PROJECT = "longreach-test"
LIMIT_M = 0.005
CLEARANCE_M = 0.10
TOKENS = "/var/lib/longreach-tokens"
RECORDS = "/var/lib/longreach-records/test"
CRASHES = int(os.environ.get("CRASHES", "1"))  # of each service
SPELLINGS = {"v2": "docker compose", "v1": "docker-compose"}
MODULES = {"plant": "plant_emulator", "controller": "controller", "vision": "vision_pc"}
KILL = (
    "import os, sys\n"
    "for pid in filter(str.isdigit, os.listdir('/proc')):\n"
    "    words = open(f'/proc/{pid}/cmdline').read().split(chr(0))\n"
    "    if words[1:3] == ['-m', sys.argv[1]]:\n"
    "        os.kill(int(pid), 9)\n"
)


def absent(spelling: str) -> str:
    """What is missing for Compose to be called so; empty: nothing."""
    if shutil.which("docker") is None:
        return "no command docker"
    engine = subprocess.run(["docker", "info"], capture_output=True, text=True)
    if engine.returncode:
        return f"no Docker engine answers: {(engine.stderr.splitlines() or ['docker info failed'])[-1]}"
    if shutil.which(spelling.split()[0]) is None:
        return f"no command {spelling}"
    if subprocess.run([*spelling.split(), "version"], capture_output=True).returncode:
        return f"no {spelling}: the plugin docker-compose is absent"
    return ""


class Containers(NamedTuple):
    """Three services of our own project, on a free port."""

    spelling: str
    port: int
    environment: dict[str, str]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def call(self, *words: str, **environment: str) -> str:
        environment = os.environ | self.environment | environment
        done = subprocess.run(
            [*self.spelling.split(), *words], env=environment, capture_output=True, text=True, cwd=ROOT
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def file(self, service: str, path: str) -> bytes:
        words = (*self.spelling.split(), "exec", "-T", service, "cat", path)
        return subprocess.check_output(words, env=os.environ | self.environment, cwd=ROOT)

    def face(self, role: str | None = "operate") -> httpx.Client:
        token = "" if role is None else self.call("exec", "-T", "vision", "cat", f"{TOKENS}/{role}").strip()
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.url, headers=headers, timeout=20.0)

    def started_at(self) -> dict[str, object]:
        ids = {name: self.call("ps", "-q", name).strip() for name in MODULES}
        shown = ("docker", "inspect", "-f", "{{.State.StartedAt}}")
        return {name: subprocess.check_output([*shown, known]) for name, known in ids.items()}


def described(spelling: str, *files: str, records: str = "") -> Containers:
    port = free_port()
    environment = {
        "COMPOSE_FILE": ":".join((str(ROOT / "docker-compose.yml"), *files)),
        "COMPOSE_PROJECT_NAME": PROJECT,
        "LONGREACH_PORT": str(port),
        "LONGREACH_RECORDS": records,
    }
    return Containers(spelling, port, environment)


@pytest.fixture(params=SPELLINGS)
def spelling(request: pytest.FixtureRequest) -> str:
    name = SPELLINGS[request.param]
    if why := absent(name):
        pytest.skip(why)
    return name


@pytest.fixture(scope="module")
def containers() -> Iterator[Containers]:
    """The three services, by the newest Compose that is here; they record."""
    missing = {name: absent(name) for name in SPELLINGS.values()}
    if all(missing.values()):
        pytest.skip("; ".join(dict.fromkeys(missing.values())))
    running = described(next(name for name, why in missing.items() if not why), records=RECORDS)
    try:
        running.call("up", "--build", "-d")
        yield running
    finally:
        print(running.call("logs", "--tail", "5"))
        running.call("down", "-v")


def test_compose_accepts_the_file(spelling: str) -> None:
    described(spelling).call("config", "-q")


def test_the_first_block_of_the_page_runs(spelling: str, tmp_path: Path) -> None:
    project = described(spelling)
    block = shell_blocks("containers.md")[0]
    if spelling == SPELLINGS["v1"]:
        block = block.replace("--wait", "-d")
    try:
        printed = pasted(block, project.url, tmp_path, project.environment, spelling, 1200.0)
        enabled, look = (each for each in documents(printed) if "service" not in each)
        assert enabled["accepted"] is True
        assert refusals([look]) == []
        assert project.call("ps", "-q").split() == [], "the block ends what it began"
    finally:
        project.call("down", "-v")


def test_the_block_of_the_readme_runs_and_answers_as_it_says(spelling: str, tmp_path: Path) -> None:
    project, readme = described(spelling), (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = [one.text for one in blocks(readme) if one.text.startswith("docker compose")]
    if spelling == SPELLINGS["v1"]:
        block = block.replace("--wait", "-d").replace(
            "curl -sS", "sleep 60; curl -sS --retry 30 --retry-all-errors"
        )
    (answer,) = re.findall(r"It answers `([^`…]*)", readme)
    try:
        printed = pasted(block, project.url, tmp_path, project.environment, spelling, 1200.0)
        assert answer.strip() in printed
    finally:
        project.call("down", "-v")


def test_the_block_of_the_rest_page_brings_the_tool_to_the_object(
    containers: Containers, tmp_path: Path
) -> None:
    with containers.face("look") as face:
        until_healthy(face)
    for wrong in ({}, {"Authorization": f"Bearer {bytes(32).hex()}"}):
        assert httpx.post(f"{containers.url}/enable", headers=wrong, timeout=20.0).status_code == 401
    for port in (1502, 47100):
        with (
            pytest.raises(OSError, match=r"refused|timed out"),
            socket.create_connection(("127.0.0.1", port), 1.0),
        ):
            pytest.fail(f"port {port} must not be published")
    (block,) = shell_blocks("rest.md")
    printed = pasted(block, containers.url, tmp_path, containers.environment, containers.spelling, 600.0)
    judge_rest_block(printed, tmp_path)
    time.sleep(1.0)
    (tmp_path / "truth.mcap").write_bytes(containers.file("plant", f"{RECORDS}/plant_emulator/truth.mcap"))
    truths = [record.truth for record in read_truth(tmp_path / "truth.mcap").truths[-20:]]
    error = np.mean([tool_error(truth, CLEARANCE_M) for truth in truths], axis=0)
    print(f"true error {1e3 * error} mm")
    assert np.all(np.abs(error[:2]) < LIMIT_M)


@pytest.mark.parametrize("service", MODULES)
def test_a_killed_service_is_started_anew_alone(containers: Containers, service: str) -> None:
    killed_s = [0.0]

    def kill(name: str) -> None:
        killed_s[0] = time.monotonic()
        containers.call("exec", "-T", name, "python", "-c", KILL, MODULES[name])

    with containers.face() as face:
        rig = Rig(face, kill, containers.started_at, serves=lambda _: time.monotonic() > killed_s[0] + 2.0)
        for one in trials(rig, service, CRASHES):
            judge(one._replace(service=MODULES[service]))


def test_one_variable_does_without_tokens_for_this_machine_alone(containers: Containers) -> None:
    containers.call("up", "-d", LONGREACH_NO_TOKEN="1")
    with containers.face(None) as face:
        until_healthy(face)
        assert face.post("/stop").is_success
    assert "no token is asked for" in containers.call("logs", "vision")
    program = (
        "import http.client as h; c = h.HTTPConnection('vision', 8000, timeout=5)\n"
        "c.request('POST', '/enable', headers={'Host': 'localhost'}); print(c.getresponse().read().decode())"
    )
    assert "refused.other_machine" in containers.call("exec", "-T", "controller", "python", "-c", program)
    containers.call("up", "-d", LONGREACH_NO_TOKEN="")
    with containers.face() as face:
        until_healthy(face)
        assert httpx.post(f"{containers.url}/stop", timeout=20.0).status_code == 401


def test_the_suite_asks_a_controller_of_this_machine(containers: Containers, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    words = ["--set", f"controller.reference_link.port={port}"]
    controller = subprocess.Popen(
        [sys.executable, "-m", "controller", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert controller.stdout is not None
    try:
        assert '"ready"' in controller.stdout.readline()
        (block,) = [block for block in shell_blocks("containers.md") if " conformance " in block]
        asked = block.replace("47000", str(port))
        printed = pasted(asked, containers.url, tmp_path, containers.environment, containers.spelling, 300.0)
        assert "HELLO is answered with WELCOME" in printed
    finally:
        controller.terminate()
        controller.communicate(timeout=30.0)
