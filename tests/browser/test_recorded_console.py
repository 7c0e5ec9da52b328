"""A recording in the console, in a real browser: it says what it is, moves as told, and has no STOP."""

import asyncio
import contextlib
import re
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from foundation.rest.server import RestServer
from testbed.recordings.console.server import RecordedConsole, recorded_app
from testbed.recordings.console.shown_pictures import ShownPictures
from testbed.recordings.console.timeline import Timeline
from testbed.recordings.recorded_vision import recorded_vision
from tests.browser.chromium import ABSENT, CHROMIUM, launched
from tests.browser.test_console import eventually, opened, serious
from tests.testbed.lockstep.recorded_run import CONTROLLER_FILE, FILES, recorded_run

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
WITHIN_S = 30.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched() as started:
        yield started


@contextlib.contextmanager
def served(directory: Path) -> Iterator[tuple[str, RecordedConsole]]:
    """The console over a recorded run, served by a thread."""
    of = Timeline(recorded_vision(directory / FILES[2]), directory / CONTROLLER_FILE)
    console = RecordedConsole(of, ShownPictures(of, directory / FILES[0]))
    server = RestServer(recorded_app(console))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listener])))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/", console
        finally:
            console.ended = server.should_exit = True
            thread.join(WITHIN_S)
    assert not thread.is_alive()


def test_a_recording_is_played_moved_and_left_alone(browser: Browser, tmp_path: Path) -> None:
    recorded_run(tmp_path, images="raw")
    asked: list[str] = []
    with served(tmp_path) as (url, console), opened(browser, url) as page:
        page.on("request", lambda sent: asked.append(f"{sent.method} {sent.url}"))
        expect(page.locator("#transport")).to_contain_text("RECORDED")
        expect(page.locator("#stop")).to_be_hidden()
        expect(page.locator("#group-buttons")).to_be_hidden()
        expect(page.locator("#chips")).to_contain_text("vision.mcap")
        length_s = 1e-9 * console.transport.length_ns
        page.locator("#seek").fill(f"{length_s - 0.1:.1f}")
        expect(page.locator("#ladder li.on")).to_have_attribute("data-state", "standby")
        expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
        expect(page.locator("#seen-told")).to_contain_text("tool seen")
        expect(page.locator("#verdict-told")).to_contain_text("Outside")
        page.locator("#seek").fill("0")
        expect(page.locator("#verdict-told")).to_contain_text("Look, or run")
        page.locator("body").press("Space")  # STOP in the console of a machine
        eventually(lambda: float(page.locator("#seek").input_value()) >= length_s - 0.15, page)
        expect(page.locator("#play")).to_have_text("Play")
        page.keyboard.press("Escape")
        page.wait_for_timeout(300)
        assert serious(page) == []
        page.set_viewport_size({"width": 390, "height": 844})
        page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        place = page.locator("#play").bounding_box()
        assert place is not None
        assert place["y"] + place["height"] <= 844, "in view without scrolling"
    assert [each for each in asked if each.startswith("POST") and not each.endswith("/recording")] == []
