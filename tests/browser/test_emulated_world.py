"""The console over `longreach up`: clicks in pictures of an emulator that runs, and its world begun anew."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.browser.chromium import ABSENT, CHROMIUM, hold, is_state
from tests.browser.open_console import eventually, opened
from tests.support.paths import ROOT

pytestmark = [
    pytest.mark.processes,
    pytest.mark.timeout(900),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
WITHIN_MS = 180_000.0  # a world that begins anew, on a machine that may be busy
UP = ("up", "--free-ports", "--allow-faults", "--show-truth", "--scenario", "drill_face", "--seed", "7")
SETTINGS = ("--set", "controller.reference_link.link_timeout_ms=5000")  # for a machine that is busy


@contextlib.contextmanager
def console(browser: Browser, directory: Path) -> Iterator[Page]:
    """The console of services that were started as an operator does."""
    command = [sys.executable, "-m", "longreach", *UP, *SETTINGS, "--out", str(directory)]
    said = directory / "up.txt"
    with said.open("w") as stdout, subprocess.Popen(command, cwd=ROOT, stdout=stdout, text=True) as up:
        try:
            until_s = time.monotonic() + 1e-3 * WITHIN_MS
            while "REST API" not in said.read_text():
                assert up.poll() is None
                assert time.monotonic() < until_s, said.read_text()
                time.sleep(0.2)
            addresses = dict(re.findall(r"(console|faults): (http://127\.0\.0\.1:\d+)/", said.read_text()))
            with opened(browser, addresses["console"], also=f"{addresses['faults']}/") as page:
                pictures = page.locator("#left")
                expect(pictures).to_have_attribute("data-frame", re.compile("[1-9]"), timeout=WITHIN_MS)
                yield page
        finally:
            up.send_signal(signal.SIGTERM)
            up.wait(60)


def click(page: Page, at_px: tuple[float, float], answer: str) -> None:
    """Click a place of the left eye; again where a busy machine showed an old picture, or was not heard."""
    for _ in range(60):
        box = page.locator("#left").bounding_box()
        assert box is not None
        u, v = at_px[0] / 1280 * box["width"], at_px[1] / 720 * box["height"]
        page.mouse.click(box["x"] + u, box["y"] + v)
        expect(page.locator("#answer")).not_to_contain_text("Measuring", timeout=WITHIN_MS)
        if not re.search(r"\((target.frame_too_old|link\.\w+)\)", page.locator("#answer").inner_text()):
            break
        page.wait_for_timeout(500)
    expect(page.locator("#answer")).to_contain_text(answer)


def middle_px(drawn: Locator) -> tuple[float, float]:
    """The middle of an outline that is drawn over the picture."""
    expect(drawn).to_have_count(1, timeout=WITHIN_MS)
    corners = re.findall(r"([\d.]+) ([\d.]+)", drawn.get_attribute("d") or "")
    u, v = np.mean(np.array(corners, float), axis=0)
    return float(u), float(v)


def tool_m(page: Page) -> list[float]:
    """Where the page says that the tool is, in the base."""
    return [float(metres) for metres in re.findall(r"-?\d\.\d+", page.locator("#tool-at").inner_text())]


def test_clicks_and_a_world_begun_anew(browser: Browser, tmp_path: Path) -> None:
    with console(browser, tmp_path) as page:
        began = tool_m(page)
        tool = page.locator("#overlay path.marker.tool")
        page.locator("#find-holes").click()
        expect(page.locator("#answer")).to_contain_text("holes found", timeout=WITHIN_MS)
        hole = middle_px(page.locator("#aims path.hole").nth(4))
        click(page, hole, "it sinks, and what is clicked is lost")
        hold(page, "#enable")
        is_state(page, "standby", WITHIN_MS)
        click(page, middle_px(tool), "the tool is before it (target.hidden). Click beside the tool")
        aimed = page.locator("#target-rows li.aimed")
        click(page, hole, "Target t1: hole 4")
        page.locator("#jog-step").select_option("100")
        page.locator("#jog-x-plus").click()
        expect(aimed).to_contain_text("carried by odometry", timeout=WITHIN_MS)
        page.locator("#start-look").click()
        look = page.locator('#procedure li[data-kind="look"] .note')
        expect(look).to_contain_text("done", timeout=WITHIN_MS)
        assert tool_m(page) != pytest.approx(began, abs=0.05)
        hold(page, "#restart-world")
        expect(page.locator("#alarm-rows")).to_contain_text("machine.begun_anew", timeout=WITHIN_MS)
        expect(page.locator("#banner")).to_contain_text("targets are void")
        expect(aimed).to_contain_text("lost: click it again")
        expect(page.locator("#seen-told")).to_contain_text("target lost", timeout=WITHIN_MS)
        expect(look).to_contain_text("void")
        expect(page.locator("#verdict-told")).to_contain_text("Look, or run the procedure")
        eventually(lambda: tool_m(page) == pytest.approx(began, abs=0.02), page)  # it sinks while disabled
        expect(page.locator("#no-picture")).to_be_hidden(timeout=WITHIN_MS)
        expect(page.locator("#truth-told")).to_be_visible(timeout=WITHIN_MS)
        is_state(page, "error_stop")
        hold(page, "#reset")
        is_state(page, "disabled")
        hold(page, "#enable")
        is_state(page, "standby")
        click(page, hole, "Target t2: hole 4")
        expect(aimed).to_contain_text("t2")
