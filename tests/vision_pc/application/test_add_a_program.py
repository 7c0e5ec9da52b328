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
