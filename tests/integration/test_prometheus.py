"""A real Prometheus (Debian's) reads the figures of all services and answers what the dashboard asks."""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from testbed.realtime.launch import free_port
from tests.integration.services import Running, running
from tests.support.crash_trials import until_healthy
from tests.support.grafana import expressions
from tests.support.paths import ROOT

_PLACES = os.pathsep.join((str(Path(sys.prefix) / "prometheus/usr/bin"), os.environ.get("PATH", os.defpath)))
PROMETHEUS, PROMTOOL = (shutil.which(name, path=_PLACES) for name in ("prometheus", "promtool"))
pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(PROMETHEUS is None, reason="no Prometheus here (make prometheus)"),
]
_WITHIN_S, _SCRAPES = 60.0, 8
_WINDOW, _SHORTER = "[1m]", "[10s]"  # the dashboard looks at minutes, a test has seconds
_BY_CAUSE = ("plant_exchange_failures", "rest_refused")  # nothing is told of what never happened


@contextlib.contextmanager
def scraping(rig: Running, directory: Path) -> Iterator[httpx.Client]:
    """Prometheus with the job of the compose profile, its targets the one face of this rig."""
    config = yaml.safe_load((ROOT / "grafana" / "prometheus.yml").read_text())
    config["global"]["scrape_interval"] = "1s"
    (job,) = config["scrape_configs"]
    (directory / "look").write_text("a token that a face on loopback does not ask for")
    job["authorization"]["credentials_file"] = str(directory / "look")
    job["static_configs"][0]["targets"] = [f"127.0.0.1:{rig.launch.foxglove}"]
    (directory / "prometheus.yml").write_text(yaml.safe_dump(config))
    assert PROMTOOL is not None
    subprocess.run([PROMTOOL, "check", "config", directory / "prometheus.yml"], check=True)
    port = free_port()
    command = [
        str(PROMETHEUS),
        f"--config.file={directory / 'prometheus.yml'}",
        f"--storage.tsdb.path={directory / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
        "--log.level=error",
    ]
    with subprocess.Popen(command) as process:
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10.0) as client:
                yield client
        finally:
            process.terminate()
            process.wait(20.0)


def answer(client: httpx.Client, expression: str) -> list[Any]:
    told = client.get("/api/v1/query", params={"query": expression})
    assert told.status_code == httpx.codes.OK, told.text
    return list(told.json()["data"]["result"])


def until_scraped(client: httpx.Client) -> None:
    """Return once several samples are there."""
    until_s = time.monotonic() + _WITHIN_S
    while time.monotonic() < until_s:
        with contextlib.suppress(httpx.TransportError):
            if client.get("/-/ready").status_code == httpx.codes.OK:
                found = answer(client, "count_over_time(up[10s])")
                if found and float(found[0]["value"][1]) >= _SCRAPES:
                    return
        time.sleep(0.5)
    raise AssertionError("Prometheus has not read the figures")


def test_prometheus_reads_every_figure_and_answers_every_panel(tmp_path: Path) -> None:
    with running(tmp_path, foxglove=0) as rig:
        until_healthy(rig.face)
        rig.face.post("/operations/look", headers={"Prefer": "wait=30"})
        text = httpx.get(f"http://127.0.0.1:{rig.launch.foxglove}/metrics").text
        assert PROMTOOL is not None
        linted = subprocess.run(
            [PROMTOOL, "check", "metrics"], input=text, capture_output=True, text=True, check=False
        )
        assert linted.returncode == 0, linted.stderr
        with scraping(rig, tmp_path) as client:
            until_scraped(client)
            assert [float(each["value"][1]) for each in answer(client, "up")] == [1.0]
            empty = [
                expression
                for expression in expressions()
                if not answer(client, expression.replace(_WINDOW, _SHORTER))
            ]
    assert not [each for each in empty if not any(name in each for name in _BY_CAUSE)]
