"""What the console does beside the procedure: the emulated world; what it says of clicks and services that
are no use.
"""

import re

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from foundation.rest.guard import Role
from protocol.faults import FaultCode
from tests.browser.chromium import ABSENT, CHROMIUM, WITHIN_MS, hold, is_state, note
from tests.browser.open_console import eventually, opened
from tests.vision_pc.shell.rest_server import served_bench

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
LOOK, OPERATE = bytes(range(32)), bytes(range(1, 33))


class NearEmulator:
    """The emulator's face, as the browser has it answer: the true arm, a little off what encoders say."""

    at = "http://127.0.0.1:9"

    def __init__(self) -> None:
        self.restarts: list[dict[str, str]] = []
        self.asked: list[dict[str, str]] = []

    def answer_for(self, page: Page) -> None:
        page.route(f"{self.at}/**", self._answer)

    def _answer(self, route: Route) -> None:
        self.asked.append(route.request.headers)
        ours = {"access-control-allow-origin": "*"}
        path = httpx.URL(route.request.url).path
        if path == "/world/restart":
            self.restarts.append(route.request.headers)
            return route.fulfill(status=202, json={"restarts": True}, headers=ours)
        points = [[0.0, 0.0, 0.0], [-0.19, 0.0, 0.85], [0.8, 0.0, 2.2], [3.5, 0.0, 1.0], [3.9, 0.0, 1.0]]
        told = {"allowed": True} if path == "/faults" else {"time_ns": 1, "arm_points_m": points}
        return route.fulfill(json=told, headers=ours)


def test_the_true_arm_comes_from_the_emulator_alone_and_its_world_begins_anew(browser: Browser) -> None:
    emulator, tokens = NearEmulator(), {Role.OPERATE: OPERATE, Role.LOOK: LOOK}
    with served_bench(emulator_face=emulator.at, tokens=tokens) as (url, _):
        page_of = opened(browser, f"{url}#t={OPERATE.hex()}", emulator.answer_for, also=f"{emulator.at}/")
        with page_of as page:
            expect(page.locator("#side-view path.ghost")).to_have_count(1, timeout=WITHIN_MS)
            expect(page.locator("#truth-told")).to_contain_text("truth (emulator)")
            page.locator("#restart-world").hover()
            expect(page.locator("#curl")).to_have_text(f"curl -X POST {emulator.at}/world/restart")
            hold(page, "#restart-world")
            eventually(lambda: len(emulator.restarts) == 1, page)
    assert not [headers for headers in emulator.asked if "authorization" in headers]  # our token is ours


def click_until(page: Page, words: str) -> None:
    """Click the middle of the left eye, and wait for the answer."""
    page.locator("#left").click(force=True)  # the overlay above it lets clicks rise
    expect(page.locator("#answer")).to_contain_text(words, timeout=WITHIN_MS)


def second_picture(page: Page) -> None:
    """Wait for it: the bench keeps no first one."""
    expect(page.locator("#left")).to_have_attribute("data-frame", re.compile(r"[2-9]|\d\d"))


def test_what_is_out_of_reach_is_told_at_the_click_and_refused_at_go(browser: Browser) -> None:
    with served_bench(enabled=False) as (url, bench):
        bench.eyes.picture_s = 0.5
        X_BO = bench.rig.truth.X_BO.copy()
        X_BO[:3, 3] += bench.rig.X_BC_true()[:3, 2] * 2.5  # m farther ahead
        bench.rig.truth = bench.rig.truth._replace(X_BO=X_BO)
        with opened(browser, url) as page:
            second_picture(page)
            expect(page.locator("#seen-told")).to_contain_text("object seen")
            click_until(page, "it sinks, and what is clicked is lost")  # and nothing is measured
            hold(page, "#enable")
            is_state(page, "standby")
            click_until(page, "OUT OF REACH of one step. Jog nearer")
            expect(page.locator("#target-rows li.aimed")).to_contain_text("OUT OF REACH")
            hold(page, "#start-local-track")
            note(page, "local-track", "done")
            began = bench.rig.q.copy()
            hold(page, "#start-look-then-move")
            note(page, "look-then-move", "limit 1.5 m (measurement.step_too_large)")
            expect(page.locator("#alarm-rows")).to_contain_text("Jog nearer, then repeat the step.")
            is_state(page, "standby")
            assert np.array_equal(bench.rig.q, began)
            page.locator("#jog-frame").select_option("base")
            for _ in range(40):  # to where the arm ends
                page.locator("#jog-step").select_option("100")
                page.locator("#jog-x-plus").click(force=True)
                page.wait_for_timeout(300)
                if "refused.unreachable" in page.locator("#jog-told").inner_text():
                    break
            expect(page.locator("#alarm-rows")).to_contain_text("Choose a target within the arm's reach")


def test_a_target_that_another_console_has_made_is_told_before_go(browser: Browser) -> None:
    with served_bench() as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url) as page:
            second_picture(page)
            click_until(page, "Target t1: hole 45.0 mm")
            page.wait_for_timeout(2_500)  # two polls later it is still what was said
            expect(page.locator("#answer")).to_contain_text("Target t1: hole 45.0 mm")
            assert httpx.post(f"{url}/targets", json={"u_px": 5.0, "v_px": 3.0}).status_code == 201
            told = "Not by this page, the target is another one now: t2 hole 45.0 mm. Go drives there."
            expect(page.locator("#answer")).to_contain_text(told, timeout=WITHIN_MS)
            click_until(page, "Target t3: hole 45.0 mm")
            page.locator("#target-rows li", has_text="t1 hole").get_by_text("Aim", exact=True).click()
            expect(page.locator("#target-rows li.aimed")).to_contain_text("t1 hole")
            page.wait_for_timeout(2_500)
            expect(page.locator("#answer")).to_contain_text("Target t3: hole 45.0 mm")
            assert httpx.delete(f"{url}/targets/t1").is_success
            expect(page.locator("#answer")).to_contain_text("now: the object’s markers", timeout=WITHIN_MS)


def test_go_drives_to_the_target_that_the_page_showed_though_another_console_has_clicked_since(
    browser: Browser,
) -> None:
    with served_bench() as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url) as page, opened(browser, url) as other:
            is_state(page, "standby")
            hold(page, "#start-local-track")
            note(page, "local-track", "done")
            note(page, "look-then-move", "ready: to the object’s markers")
            page.route("**/targets", lambda route: route.abort())  # what follows comes too late for this page
            second_picture(other)
            click_until(other, "Target t1: hole 45.0 mm")
            page.locator("#start-look-then-move").hover()
            named = '{"method":"corrected","target":"markers"}'
            expect(page.locator("#curl")).to_contain_text(named)
            page.locator("#start-looking-and-moving").hover()
            expect(page.locator("#curl")).to_contain_text('{"target":"markers"}')
            hold(page, "#start-look-then-move")
            note(page, "look-then-move", "done")
            assert bench.eyes.targets.aimed is None
            page.unroute("**/targets")
            click_until(page, "Target t2: hole 45.0 mm")
            page.route("**/targets", lambda route: route.abort())
            click_until(other, "Target t3: hole 45.0 mm")
            hold(page, "#start-look-then-move")
            eventually(
                lambda: httpx.get(f"{url}/operations").json()[-1]["request"].get("target") == "t2", page
            )
            for each in (page, other):  # whoever drove
                note(each, "look-then-move", " at t2: x")
            hold(page, "#start-visit")
            eventually(lambda: httpx.get(f"{url}/operations").json()[-1]["kind"] == "visit", page)
            row = httpx.get(f"{url}/operations").json()[-1]["request"]["targets"]
            assert row == ["t1", "t2"]
            page.keyboard.press("Escape")
            assert httpx.delete(f"{url}/targets/t2").is_success
            is_state(page, "standby")
            hold(page, "#start-orientation-adjustment")
            expect(page.locator("#answer")).to_contain_text(
                "no target 't2'; known: t1, t3 (refused.unknown_target)"
            )


def test_a_row_of_targets_is_visited_and_who_is_not_enabled_is_told_what_comes_next(browser: Browser) -> None:
    with served_bench(enabled=False) as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url) as page:
            second_picture(page)
            click_until(page, "The arm is disabled")
            expect(page.locator("#start-visit")).to_be_hidden()
            hold(page, "#enable")
            is_state(page, "standby")
            click_until(page, "Next: local calibration (step 2), then Go.")
            page.set_viewport_size({"width": 390, "height": 844})
            click_until(page, "Next: local calibration (step 2), then Go.")
            expect(page.locator("#answer")).to_be_in_viewport()  # though its place is far below
            page.set_viewport_size({"width": 1280, "height": 720})
            hold(page, "#start-visit")
            told = page.locator('#target-steps li[data-kind="visit"] .note')
            expect(told).to_contain_text(re.compile(r"done .*: t1 \d\.\d mm beside, t2 \d\.\d mm beside"),
                                         timeout=WITHIN_MS)  # fmt: skip
            click_until(page, "Hold Go to drive there.")
            bench.controller.break_down(FaultCode.FOLLOWING_ERROR)
            is_state(page, "error_stop")
            expect(page.locator("#answer")).to_have_text("")  # that is no longer what comes next
            hold(page, "#reset")
            is_state(page, "disabled")
            for _ in range(8):
                assert httpx.post(f"{url}/targets", json={"u_px": 600.0, "v_px": 300.0}).status_code == 201
            newest = page.locator("#target-rows li.aimed")
            expect(newest).to_contain_text("t11")
            page.locator("#targets").scroll_into_view_if_needed()
            expect(newest).to_be_in_viewport()  # of a list that scrolls


def test_who_clicks_while_another_operator_works_is_told_so(browser: Browser) -> None:
    with served_bench() as (url, bench), opened(browser, url) as page:
        bench.eyes.picture_s = 0.5
        bench.eyes.look_s = 3.0
        expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
        other = httpx.post(f"{url}/operations/orientation-adjustment", json={})
        assert other.status_code == 202, other.text
        page.locator("#left").click(force=True)  # the overlay above it lets clicks rise
        busy = "(refused.busy). Wait for the operation that runs, or cancel it."
        expect(page.locator("#answer")).to_contain_text(busy, timeout=WITHIN_MS)
        assert httpx.get(f"{url}/targets").json() == {"targets": []}


def test_holes_are_found_at_rest_alone_for_their_outlines_stay_drawn(browser: Browser) -> None:
    with served_bench() as (url, bench):
        bench.eyes.picture_s = 0.5
        bench.controller.speed = 0.0001
        with opened(browser, url) as page:
            is_state(page, "standby")
            assert httpx.post(f"{url}/operations/move", json={"offset_tool_m": [0.02, 0.0, 0.0]}).is_success
            is_state(page, "moving")
            page.locator("#find-holes").click()
            expect(page.locator("#answer")).to_contain_text("Wait until it is at rest, then find holes.")
            expect(page.locator("#aims path.hole")).to_have_count(0)
            page.keyboard.press("Escape")
            is_state(page, "standby")
            page.locator("#find-holes").click()
            expect(page.locator("#aims path.hole")).to_have_count(1, timeout=WITHIN_MS)
