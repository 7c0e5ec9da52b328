"""What the console has for a machine that is put into service: hand-eye calibration, trial of valves."""

from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, expect

from protocol.faults import FaultCode, GroupState
from tests.browser.chromium import ABSENT, CHROMIUM, WITHIN_MS, hold, is_state
from tests.browser.open_console import console, eventually, opened, serious
from tests.vision_pc.shell.rest_server import served_bench

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]


@pytest.mark.parametrize("width", [390, 1280])
def test_who_holds_enable_of_a_controller_that_tries_valves_was_told_what_will_move(
    browser: Browser, width: int
) -> None:
    with (
        served_bench(enabled=False, tries_valves=True) as (url, bench),
        opened(browser, url, viewport={"width": width, "height": 844}) as page,
    ):
        is_state(page, "disabled")
        told = page.locator("#trials")
        expect(told).to_contain_text("ENABLE moves the arm: it begins a trial of the valves")
        for words in (
            "one joint after another",
            "3° a stroke (wrists 5°)",
            "never more than 15°",
            "about 15 minutes",
            "tool must be empty",
            "STOP, Space or Esc closes all valves",
        ):
            expect(told).to_contain_text(words)
        expect(page.locator("#enable")).to_have_attribute("aria-describedby", "trials")
        expect(page.locator("#enable small")).to_have_text("hold: it moves")
        expect(page.locator("#procedure-wants")).to_have_text("this controller only tries out valves")
        assert page.locator("#start-look-then-move").is_disabled()
        page.locator("#enable").scroll_into_view_if_needed()
        above, button = (page.locator(place).bounding_box() for place in ("#trials", "#enable"))
        assert above is not None
        assert button is not None  # who reaches for ENABLE has read on past it
        assert above["y"] + above["height"] <= button["y"]
        assert serious(page) == []
        hold(page, "#enable")
        is_state(page, "moving")
        expect(told).to_contain_text("The valves are being tried out")
        page.keyboard.press("Escape")
        expect(page.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
        eventually(lambda: bench.controller.group is GroupState.STANDBY, page)
        expect(told).to_contain_text("has ended, or was stopped")
        bench.controller.break_down(FaultCode.FOLLOWING_ERROR)
        expect(page.locator("#resume")).to_contain_text("Hold ENABLE: the trial goes on, and the arm moves")


def test_of_a_controller_that_follows_references_nothing_is_said_of_trials(browser: Browser) -> None:
    with console(browser) as (page, _, _):
        expect(page.locator("#enable small")).to_have_text("hold")
        expect(page.locator("#trials")).to_be_hidden()
        assert page.locator("#enable").get_attribute("aria-describedby") is None


def test_hand_eye_is_on_the_page(browser: Browser) -> None:
    with console(browser, viewport={"width": 1440, "height": 900}) as (page, _, _):
        posted: list[tuple[str, Any]] = []
        page.on("request", lambda asked: posted.append((httpx.URL(asked.url).path, asked.post_data_json))
                if asked.method == "POST" else None)  # fmt: skip
        page.locator("#hand-eye summary").focus()
        page.keyboard.press("Enter")  # by keyboard alone
        page.locator("#start-hand-eye-start").click()
        expect(page.locator("#answer")).to_contain_text("Give the session a name", timeout=WITHIN_MS)
        page.locator("#hand-eye-name").fill("monday")
        page.locator("#start-hand-eye-start").click()
        eventually(lambda: ("/operations/hand-eye-start", {"name": "monday"}) in posted, page)
        assert page.locator("#start-hand-eye-next").is_disabled()  # it moves the arm, which is disabled
        assert serious(page) == []
