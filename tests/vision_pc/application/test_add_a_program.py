"""docs/how_to/add_a_program.md does what it says: its own blocks are run, in lockstep and over the API."""

import importlib
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.support.pages import page
from tests.support.paths import ROOT
from tests.vision_pc.synthetic_station import bench
from vision_pc.application.programs import PROGRAMS
from vision_pc.shell.rest.api import create_app

TEXT = page("how_to/add_a_program.md")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


FILES = {"there_and_back": BLOCKS[0] + BLOCKS[1], "run_it": BLOCKS[2], "serve_it": BLOCKS[3]}


@pytest.fixture
def page_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Any]]:
    """Import a file of the page, saved and run from where the page says."""
    for name, text in FILES.items():
        assert f"`{name}.py`" in TEXT
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(ROOT)
    yield importlib.import_module
    for name in FILES:
        sys.modules.pop(name, None)


@pytest.mark.slow("a run in lockstep")
def test_the_page_s_program_runs_in_lockstep(page_module: Callable[[str], Any]) -> None:
    run_it = page_module("run_it")
    assert 0.0 < max(abs(run_it.result.shift_m)) < 5e-3
    ended = [event for event in run_it.rig.world.log.events if event["event"] == "operation_ended"]
    assert ended[-1]["kind"] == "there-and-back"
    assert 0.0 < ended[-1]["result"]["shift_mm"] < 5.0


async def test_the_page_s_program_is_served_with_its_guards_and_ranges(
    page_module: Callable[[str], Any],
) -> None:
    row = page_module("there_and_back").THERE_AND_BACK
    async with bench() as made:
        app = create_app(made.station, made.operations, (*PROGRAMS, row))
        made.client = httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://vision")
        async with made.client:
            refused = await made.post("/operations/there-and-back")
            assert (refused.status_code, refused.json()["cause"]) == (409, "refused.disabled")
            await made.post("/enable")
            too_far = await made.post("/operations/there-and-back", {"stroke_mm": 301.0})
            assert (too_far.status_code, too_far.json()["cause"]) == (422, "request.invalid")
            ended = await made.run("there-and-back", {"stroke_mm": 30.0})
            assert ended["state"] == "succeeded", ended["problem"]
            assert ended["result"]["shift_mm"] < 5.0
            member = app.openapi()["components"]["schemas"]["StrokeBody"]["properties"]["stroke_mm"]
            assert member["anyOf"][0] == {"type": "number", "maximum": 300.0, "exclusiveMinimum": 0.0}


def test_the_page_s_service_serves_it(page_module: Callable[[str], Any]) -> None:
    """The page's own service, on a free port, without controller and camera."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    served: list[Any] = []

    def ask() -> None:
        answer = httpx.HTTPTransport(retries=0)
        with httpx.Client(transport=answer, base_url=f"http://127.0.0.1:{port}") as client:
            while not served:
                try:
                    served.append(client.get("/openapi.json").json()["paths"])
                except httpx.TransportError:
                    time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGTERM)

    asking = threading.Thread(target=ask)
    asking.start()
    assert page_module("serve_it").serve("--set", f"vision.api.port={port}") == 0
    asking.join()
    assert "/operations/there-and-back" in served[0]
    assert "/operations/hand-eye-start" in served[0]
