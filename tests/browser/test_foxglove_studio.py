"""Recordings, layout and live face in a viewer of others: Foxglove Studio 1.48 (`make viewer`)."""

import contextlib
import datetime
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from playwright.sync_api import Browser, ConsoleMessage, Page, expect, sync_playwright

from testbed.recordings.layout import layout_text
from testbed.recordings.merging import merge
from tests.browser.chromium import CHROMIUM, WITHIN_MS
from tests.integration.services import running
from tests.testbed.lockstep.recorded_run import FILES, recorded_run
from tools.foxglove_studio.serving import STUDIO, address, as_called_in_1_48, served

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (make browser): viewer NOT tried"),
    pytest.mark.skipif(not STUDIO.is_dir(), reason="no viewer here (make viewer): recordings NOT looked at"),
]
_ARGUMENTS = ["--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
              "--enable-unsafe-swiftshader"]  # fmt: skip


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    expect.set_options(timeout=WITHIN_MS)
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS, timeout=120_000)
        with contextlib.closing(launched):
            yield launched


@pytest.fixture(scope="module")
def merged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("viewer")
    recorded = recorded_run(directory / "run", images="jpeg")
    merge([recorded.directory / name for name in FILES], directory / "session.mcap")
    return directory / "session.mcap"


@contextlib.contextmanager
def opened(browser: Browser, url: str) -> Iterator[tuple[Page, list[str]]]:
    """The studio's page, and what it complains of."""
    page = browser.new_page(viewport={"width": 1500, "height": 900})
    complaints: list[str] = []

    def heard(message: ConsoleMessage) -> None:
        if message.type == "error":
            complaints.append(f"{message.location.get('url')}: {message.text}")

    page.on("console", heard)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    with contextlib.closing(page):
        page.goto(url, timeout=WITHIN_MS)
        expect(page.get_by_text("Joint angles, rad")).to_be_visible()
        yield page, complaints


def coloured(page: Page, lowest: tuple[int, ...], highest: tuple[int, ...]) -> int:
    """How many pixels of the page have a colour (hue in 2 degrees, saturation, value) in these bounds."""
    picture = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return int(cv2.countNonZero(cv2.inRange(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV), lowest, highest)))


def outlined(page: Page) -> int:
    """Pixels of the green in which markers are outlined in the camera's picture."""
    return coloured(page, (50, 60, 90), (70, 255, 255))


def drawn(page: Page) -> None:
    """Return once the arm's links, which are yellow, are there in 3D."""
    for _ in range(60):
        found = coloured(page, (18, 150, 120), (28, 255, 255))
        if found > 3000:
            return
        page.wait_for_timeout(1000)
    raise AssertionError(f"no arm was drawn: {found} pixels have its colour")


def test_a_merged_recording_is_drawn_with_the_layout_in_it(browser: Browser, merged: Path) -> None:
    with merged.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        layout = next(each.data for each in reader.iter_attachments() if each.name == "layout.json")
    assert summary is not None
    assert summary.statistics is not None
    last = datetime.datetime.fromtimestamp(1e-9 * summary.statistics.message_end_time - 0.1, datetime.UTC)
    with (
        served(layout.decode(), merged) as origin,
        opened(browser, address(origin, at=f"{last:%FT%T.%fZ}")) as (page, complaints),
    ):
        drawn(page)
        expect(page.get_by_text("verdict outside")).to_be_visible()
        assert outlined(page) > 100
        page.get_by_text("Problems").first.click()
        expect(page.get_by_text("No problems found")).to_be_visible()
        assert complaints == []


@pytest.mark.realtime
def test_a_running_machine_is_drawn_live(browser: Browser, tmp_path: Path) -> None:
    with (
        served(layout_text()) as origin,
        running(tmp_path, f'vision.live.allowed_origins=["{origin}"]', foxglove=0) as rig,
        opened(browser, address(origin, live=f"ws://127.0.0.1:{rig.launch.foxglove}")) as (page, complaints),
    ):
        drawn(page)
        expect(page.get_by_text("longreach: vision, controller")).to_be_visible()
        assert complaints == []


def test_the_layout_is_whole() -> None:
    """What this viewer reads without asking whether it is there."""
    layout = as_called_in_1_48(json.loads(layout_text()))
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} <= set(layout)
