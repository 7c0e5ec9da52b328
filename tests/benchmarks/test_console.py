"""How fast the console is: the real services, a real browser, `make bench`."""

import contextlib
import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from controller.shell.scan_recorder import FILE
from testbed.realtime.launch import CONTROLLER
from tests.browser.chromium import ABSENT, CHROMIUM, hold, is_state
from tests.browser.stop_times import RESTED_S, read_scans, standby_openings, stop_times
from tests.integration.services import Running, running, until_healthy

pytestmark = [
    pytest.mark.bench,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
DESK: Any = {"width": 1440, "height": 900}
WATCHED_S = 60.0
TRIALS = int(os.environ.get("CONSOLE_STOPS", "100"))
EVERY_SCAN_HZ = 1000  # or as many as there are
PAGE_KB, CANVAS_MS, STOP_MS = 250.0, 120.0, 150.0


@contextlib.contextmanager
def services(directory: Path, *assignments: str) -> Iterator[Running]:
    """The three services, with pictures and a session."""
    with running(directory, *assignments) as rig:
        until_healthy(rig)
        yield rig


@contextlib.contextmanager
def opened(browser: Browser, rig: Running) -> Iterator[Page]:
    with contextlib.closing(browser.new_context(viewport=DESK)) as context:
        context.set_default_timeout(60_000)
        page = context.new_page()
        page.goto(rig.launch.rest_url)
        is_state(page, "disabled")
        expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
        yield page


def monotonic_of(page: Page) -> tuple[float, float]:
    """What to add to the page's ``performance.now()`` for the monotonic clock, and ± how much, ms."""
    tied = []
    for _ in range(60):
        before = time.monotonic_ns() / 1e6
        now = page.evaluate("performance.now()")
        after = time.monotonic_ns() / 1e6
        tied.append((after - before, 0.5 * (before + after) - now))
    span, offset = min(tied)
    return offset, 0.5 * span


def told(name: str, values: Any, unit: str) -> str:
    """One line; what was not measured (None) is counted, and is no part of the percentiles."""
    known = [value for value in values if value is not None]
    if not known:
        return f"{name}: none of {len(values)} measured"
    p50, p95, p99 = np.percentile(known, [50, 95, 99])
    missing = "" if len(known) == len(values) else f" ({len(values) - len(known)} NOT measured)"
    return (
        f"{name}, {len(known)}{missing}: p50 {p50:.1f}, p95 {p95:.1f}, p99 {p99:.1f}, "
        f"most {np.max(known):.1f} {unit}"
    )


def test_from_capture_to_canvas_and_the_page_itself(browser: Browser, tmp_path: Path) -> None:
    with services(tmp_path) as rig, opened(browser, rig) as page:
        sizes = page.evaluate("""['navigation', 'resource'].flatMap((kind) =>
            performance.getEntriesByType(kind).map((each) => [each.name, each.encodedBodySize]))""")
        page_kb = sum(size for name, size in sizes if "/events" not in name and "/live" not in name) / 1e3
        offset, doubt = monotonic_of(page)
        page.evaluate("""() => {
            const left = document.querySelector('#left');
            window.drawn = [];
            new MutationObserver(() => window.drawn.push([performance.now(), Number(left.dataset.captureMs)]))
                .observe(left, { attributeFilter: ['data-frame'] });
        }""")
        page.wait_for_timeout(1e3 * WATCHED_S)
        drawn = np.array(page.evaluate("window.drawn"))
    taken = drawn[:, 0] + offset - drawn[:, 1]
    print(f"\npage: {page_kb:.0f} kB compressed")
    print(told("capture to canvas", taken, f"ms (clocks tied to ±{doubt:.1f} ms)"))
    print(f"pictures: {len(drawn) / WATCHED_S:.1f} a second")
    assert page_kb <= PAGE_KB
    assert np.percentile(taken, 95) <= CANVAS_MS


def moving(rig: Running, number: int) -> None:
    """Returns in the middle of a motion."""
    offset = [0.0, 0.15 * (-1) ** number, 0.0]
    accepted = rig.face.post("/operations/move", json={"offset_base_m": offset, "duration_s": 3.0})
    assert accepted.status_code == httpx.codes.ACCEPTED, accepted.text
    eventually(lambda: rig.face.get("/state").json()["group_state"] == "moving")
    time.sleep(0.7 + 0.01 * number)  # at any phase


def eventually(happened: Callable[[], bool]) -> None:
    until_s = time.monotonic() + 20.0
    while not happened():
        assert time.monotonic() < until_s, "did not happen"
        time.sleep(0.02)


def test_from_the_click_on_stop_to_the_stops_own_valves(browser: Browser, tmp_path: Path) -> None:
    every_scan = f"controller.recording_hz={EVERY_SCAN_HZ}"
    with services(tmp_path, every_scan) as rig, opened(browser, rig) as page:
        page.evaluate("""() => {
            window.told = [];
            document.querySelector('#stop').addEventListener('pointerdown',
                (event) => { window.pressed = event.timeStamp; }, { capture: true });
            document.addEventListener('stopped',
                () => window.told.push([window.pressed, performance.now()]));
        }""")
        hold(page, "#enable")
        is_state(page, "standby")
        for number in range(TRIALS):
            moving(rig, number)
            page.locator("#stop").click()
            eventually(lambda wanted=number + 1: page.evaluate("window.told.length") == wanted)
            eventually(lambda: rig.face.get("/state").json()["group_state"] == "standby")
            time.sleep(2.0 * RESTED_S)
        offset, doubt = monotonic_of(page)
        clicks = page.evaluate("window.told")
    scans = read_scans(rig.launch.records(CONTROLLER) / FILE)
    openings = standby_openings(scans)
    heard = [answer - click for click, answer in clicks]
    asked = [1e6 * (click + offset) for click, _ in clicks]
    taken = [
        stop_times(scans, begin, end, openings)
        for begin, end in zip(asked, [*asked[1:], np.inf], strict=True)
    ]
    answered, stood, settled = zip(*taken, strict=True)
    print(f"\nby every scan of the controller; clocks tied to ±{doubt:.1f} ms")
    print(told("click on STOP to acknowledged on the page", heard, "ms"))
    print(told("click on STOP to the first valve words of the stop", answered, "ms"))
    print(told("click on STOP to the end of its ramp", stood, "ms"))
    print(told("click on STOP to valves as in standby", settled, "ms"))
    print("standby opens the valves by at most %:", np.round(100.0 * openings, 2).tolist())
    assert None not in answered
    assert np.percentile([each for each in answered if each is not None], 99) <= STOP_MS
    assert np.percentile(heard, 99) <= STOP_MS
