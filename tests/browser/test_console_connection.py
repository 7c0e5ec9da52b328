"""A console whose requests or streams are held up, die or come late, and one that is left open."""

import contextlib
import re

import httpx
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from protocol.faults import FaultCode, GroupState
from tests.browser.chromium import ABSENT, CHROMIUM, WITHIN_MS, hold, is_state
from tests.browser.open_console import eventually, opened
from tests.browser.stranding_relay import stranding
from tests.vision_pc.shell.rest_server import served_bench

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
HIDDEN = """(hidden) => {
    Object.defineProperty(document, 'hidden', { value: hidden, configurable: true });
    document.dispatchEvent(new Event('visibilitychange'));
}"""


def test_what_was_not_answered_may_still_happen_and_the_page_says_so(browser: Browser) -> None:
    with served_bench() as (url, _), opened(browser, url) as page:
        is_state(page, "standby")
        page.route("**/operations/move", lambda route: route.abort())
        page.route("**/targets?detect=true", lambda route: route.abort())
        page.route("**/operations/look", lambda _: None)  # heard, and never answered
        told = page.locator("#answer")
        page.locator("#jog-x-plus").click()
        expect(told).to_contain_text(
            "does not answer: it may still do what was asked. Watch the arm; STOP ends it."
        )
        page.locator("#find-holes").click()
        expect(told).to_have_text("▲ The vision PC does not answer. Ask once more.")
        page.locator("#start-look").click()
        expect(told).to_contain_text("has not answered for 10 s: it may still do what was asked.")


def test_who_opened_the_page_is_asked_until_it_is_answered(browser: Browser) -> None:
    """On a slow network that one question may be lost while pictures come: nobody had to reload the page."""
    lost: list[Route] = []

    def lose_the_first(page: Page) -> None:
        page.route("**/access", lambda route: lost.append(route) if len(lost) < 2 else route.continue_())

    with served_bench(enabled=False) as (url, _), opened(browser, url, before=lose_the_first) as page:
        is_state(page, "disabled")
        enable = page.locator("#enable")
        expect(enable).to_have_attribute("title", "the vision PC has not told yet who you are")
        expect(enable).to_be_disabled()
        expect(page.locator("#whoami")).to_have_text("operate", timeout=WITHIN_MS)
        assert len(lost) == 2
        hold(page, "#enable")
        is_state(page, "standby")


def test_what_a_network_held_up_is_refused_when_it_comes_at_last(browser: Browser) -> None:
    """The page sends when it was looked at; what comes late moves nothing, STOP is heard all the same."""
    with served_bench() as (url, _), opened(browser, url) as page:
        is_state(page, "standby")
        held: list[Route] = []
        page.route("**/operations/move", lambda route: held.append(route))
        page.locator("#jog-x-plus").click()
        page.wait_for_timeout(6000)
        held[0].continue_()
        told = page.locator("#answer")
        expect(told).to_contain_text("at most 5 s: nothing was done (refused.asked_too_late)")
        assert not httpx.get(f"{url}/operations").json()
        page.unroute("**/operations/move")
        page.locator("#jog-x-plus").click()
        eventually(lambda: [one["kind"] for one in httpx.get(f"{url}/operations").json()] == ["move"], page)


def test_a_page_left_open_goes_on_when_its_service_has_begun_anew(browser: Browser) -> None:
    with contextlib.ExitStack() as outer:
        with served_bench() as (url, _):
            page = outer.enter_context(opened(browser, url))
            is_state(page, "standby")
        expect(page.locator("#chips")).to_contain_text("no word from the vision PC", timeout=WITHIN_MS)
        with served_bench(enabled=False, port=httpx.URL(url).port or 0):
            is_state(page, "disabled")  # what is told is the new service's
            expect(page.locator("html")).not_to_have_class("stale", timeout=WITHIN_MS)
            hold(page, "#enable")
            is_state(page, "standby")


def test_a_page_left_open_over_night_follows_nothing_and_is_up_to_date_in_the_morning(
    browser: Browser,
) -> None:
    def with_clock(page: Page) -> None:
        page.clock.install()

    with served_bench() as (url, bench), opened(browser, url, with_clock) as page:
        bench.eyes.picture_s = 0.5
        is_state(page, "standby")
        expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
        page.evaluate(HIDDEN, True)
        shown = page.locator("#left").get_attribute("data-frame") or ""
        asked: list[str] = []
        page.on("request", lambda sent: asked.append(sent.url))
        page.clock.fast_forward("08:00:00")
        page.wait_for_timeout(1_000)
        assert asked == []
        expect(page.locator("html")).to_have_class("stale")
        bench.controller.break_down(FaultCode.EMERGENCY_STOP)  # what has happened over night
        page.evaluate(HIDDEN, False)
        is_state(page, "error_stop")
        expect(page.locator("html")).not_to_have_class("stale", timeout=WITHIN_MS)
        expect(page.locator("#alarm-line")).to_contain_text("emergency")
        expect(page.locator("#left")).not_to_have_attribute("data-frame", shown, timeout=WITHIN_MS)
        expect(page.locator("#no-picture")).to_be_hidden()


def test_streams_that_died_without_a_word_are_begun_anew_and_stop_is_heard_meanwhile(
    browser: Browser,
) -> None:
    with served_bench() as (url, bench), stranding(httpx.URL(url).port or 0) as relay:
        bench.eyes.picture_s = 0.5
        bench.controller.speed = 0.0001
        with opened(browser, relay.url) as page:
            is_state(page, "standby")
            expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
            moving = httpx.post(f"{url}/operations/move", json={"offset_tool_m": [0.02, 0.0, 0.0]})
            assert moving.status_code == 202, moving.text
            is_state(page, "moving")
            assert relay.strand() >= 2
            expect(page.locator("#chips")).to_contain_text("no word from the vision PC", timeout=WITHIN_MS)
            page.keyboard.press("Escape")
            expect(page.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
            eventually(lambda: bench.controller.group is GroupState.STANDBY, page)
            relay.strand()
            expect(page.locator("#chips")).to_contain_text("no word from the vision PC", timeout=WITHIN_MS)
            expect(page.locator("html")).not_to_have_class("stale", timeout=WITHIN_MS)
            is_state(page, "standby")
            shown = page.locator("#left").get_attribute("data-frame") or ""
            expect(page.locator("#left")).not_to_have_attribute("data-frame", shown, timeout=WITHIN_MS)
