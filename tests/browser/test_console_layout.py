"""What is in view on a screen when all goes wrong, and a picture that is old although it comes now."""

import re
import time

import httpx
import pytest
from playwright.sync_api import Browser, expect

from foundation.incidents import ServiceIncident
from tests.browser.chromium import ABSENT, CHROMIUM, WITHIN_MS, is_state
from tests.browser.open_console import opened
from tests.vision_pc.shell.rest_server import served_bench

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
_CRASHED = "plant_emulator crashed with signal SIGKILL (somebody else ended it); it is started anew"
# how far the third row reaches below its box and the red line beyond its own; what is empty below the targets
_LAYOUT = """() => {
    const bottom = (selector) => document.querySelector(selector).getBoundingClientRect().bottom;
    const line = document.querySelector('#alarm-line');
    return [bottom('#alarm-rows tr:nth-child(3)') - bottom('#alarms'), line.scrollWidth - line.clientWidth,
            bottom('#eye') - bottom('#targets')];
}"""


def test_three_alarms_are_in_view_the_crash_first_and_whole(browser: Browser) -> None:
    with served_bench() as (url, bench):
        crash = ServiceIncident(time.time(), "plant_emulator", "service.crashed", _CRASHED)
        bench.station.incidents = lambda: (crash,)
        bench.eyes.age_ms, bench.eyes.trouble = None, "link.camera_silent"
        httpx.post(f"{url}/emergency-stop")
        for width, height in ((1024, 768), (1440, 900)):
            with opened(browser, url, viewport={"width": width, "height": height}) as page:
                is_state(page, "error_stop")
                expect(page.locator("#alarm-rows tr.active")).to_have_count(3, timeout=WITHIN_MS)
                expect(page.locator("#alarm-rows tr").first).to_contain_text(_CRASHED)
                expect(page.locator("#alarm-line")).to_contain_text(_CRASHED)
                below, beyond, empty = page.evaluate(_LAYOUT)
                assert below < 0, width
                assert beyond <= 0, width
                assert empty < 60, width


def test_a_picture_is_old_by_its_capture_although_it_comes_now(browser: Browser) -> None:
    with served_bench() as (url, bench):
        bench.eyes.picture_s, bench.eyes.behind_s = 0.1, 0.8
        with opened(browser, url) as page:
            told = page.locator("#no-picture")
            expect(told).to_contain_text(re.compile(r"This picture is (0\.[89]|1\.\d) s old"))
            bench.eyes.behind_s = 0.0
            expect(told).to_be_hidden()
