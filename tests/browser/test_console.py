"""The console in a real browser, over the synthetic arm: what an operator does, and what goes wrong.

Playwright drives Debian's Chromium (`make browser`). The arm in 3D is left out: drawing it without a graphics
processor takes a core.
"""

import contextlib
import re
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from foundation.rest.guard import Role
from protocol.faults import FaultCode, GroupState
from tests.browser.chromium import ABSENT, CHROMIUM, WITHIN_MS, hold, is_state, note, reach
from tests.browser.open_console import console, eventually, opened, serious
from tests.vision_pc.shell.rest_server import served_bench

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason=ABSENT),
]
LOOK, OPERATE = bytes(range(32)), bytes(range(1, 33))


def slip(page: Page) -> None:
    """Press ENABLE too briefly, until the page has noticed it: see ``hold``."""
    for _ in range(20):
        page.locator("#enable").click(force=True)
        with contextlib.suppress(AssertionError):
            return expect(page.locator("#answer")).to_contain_text("hold it", timeout=2_000.0)
    raise AssertionError("a slip was not noticed")


@pytest.mark.parametrize("by_key", [False, True])
def test_the_procedure_by_clicks_or_keys_alone_ends_inside_the_tolerance(
    browser: Browser, by_key: bool
) -> None:
    with console(browser) as (page, bench, _):
        assert page.locator("#start-look-then-move").is_disabled()
        expect(page.locator("button.primary")).to_have_id("enable")
        expect(page.locator("#procedure-wants")).to_have_text("hold ENABLE first")
        page.keyboard.press("Escape")
        expect(page.locator("#answer")).to_contain_text("What was running has ended; the arm is disabled.")
        if not by_key:
            slip(page)
        is_state(page, "disabled")
        hold(page, "#enable", by_key)
        is_state(page, "standby")
        expect(page.locator("#procedure-wants")).to_have_text("")
        for kind in ("orientation-adjustment", "local-track", "look-then-move"):
            expect(page.locator("button.primary")).to_have_id(f"start-{kind}")  # what is due is marked, alone
            hold(page, f"#start-{kind}", by_key)
            note(page, kind, "done")
        expect(page.locator("#verdict-told")).to_contain_text("Inside ±5 mm, and its 95 % interval is, too.")
        expect(page.locator("#verdict-told")).to_contain_text(
            re.compile(r"Predicted before the drive: .* inside")
        )
        assert max(abs(1e3 * bench.rig.true_error(0.1)[:2])) < 5.0
        if by_key:
            reach(page, "#jog-x-plus")
        else:
            page.locator("#jog-x-plus").hover()
        expect(page.locator("#curl")).to_contain_text('"offset_tool_m":[0.02,0,0]')
        expect(page.locator("#overlay path.told")).to_have_count(1)
        assert int(page.locator("#left").get_attribute("data-frame") or 0) > 0


def jog(page: Page) -> None:
    """Press until the arm moves: while a busy machine has the page hear nothing, its buttons are off."""
    for _ in range(20):
        page.locator("#jog-x-plus").click(force=True)
        with contextlib.suppress(AssertionError):
            return is_state(page, "moving", 3_000.0)
    raise AssertionError("no jog was accepted")


def test_stop_ends_a_motion_by_click_and_by_key(browser: Browser) -> None:
    with console(browser) as (page, bench, url):
        bench.controller.speed = 0.0001  # 20 mm take minutes: nothing ends before it is stopped
        for stop in (lambda: page.locator("#stop").click(), lambda: page.keyboard.press("Space"),
                     lambda: page.keyboard.press("Escape")):  # fmt: skip
            if bench.controller.group is GroupState.DISABLED:
                hold(page, "#enable")
            is_state(page, "standby")
            expect(page.locator("#jog-x-plus")).to_be_enabled(timeout=WITHIN_MS)
            jog(page)  # the button keeps the focus: Space must not press it again
            began = len(httpx.get(f"{url}/operations").json())
            stop()
            expect(page.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
            told, button = (page.locator(place).bounding_box() for place in ("#stop-told", "#stop"))
            assert told is not None
            assert button is not None  # what became of it is read where one has clicked
            assert told["y"] + told["height"] < button["y"] + button["height"]
            eventually(lambda: bench.controller.group is GroupState.STANDBY, page)
            expect(page.locator("#answer")).to_contain_text("ENABLE still holds.")
            operations = httpx.get(f"{url}/operations").json()
            assert len(operations) == began
            eventually(
                lambda: httpx.get(f"{url}/operations").json()[-1]["state"] in ("cancelled", "failed"), page
            )


def test_however_many_windows_are_open_stop_has_a_connection(browser: Browser) -> None:
    with console(browser) as (page, bench, url):
        windows = [page]
        for _ in range(3):  # the streams of three alone would take all six connections of a browser
            windows.append(page.context.new_page())
            windows[-1].goto(url)
        third, fourth = windows[2:]
        is_state(third, "disabled")
        expect(third.locator("#no-picture")).to_contain_text("Other windows", timeout=WITHIN_MS)
        expect(fourth.locator("#banner")).to_contain_text("as many windows as it can", timeout=WITHIN_MS)
        hold(third, "#enable")
        is_state(third, "standby")
        fourth.keyboard.press("Escape")
        expect(fourth.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
        page.close()
        is_state(fourth, "standby")
        assert bench.controller.group is GroupState.STANDBY


def test_a_fault_is_told_with_the_way_on_and_a_lost_service_greys_the_page(browser: Browser) -> None:
    with contextlib.ExitStack() as outer:
        with served_bench() as (url, bench):
            bench.eyes.picture_s = 0.5
            page = outer.enter_context(opened(browser, url))
            is_state(page, "standby")
            bench.controller.break_down(FaultCode.FOLLOWING_ERROR)
            is_state(page, "error_stop")
            expect(page.locator("#alarm-rows tr.active")).to_contain_text("fault.following_error")
            expect(page.locator("#resume li.next")).to_contain_text("Hold RESET")
            hold(page, "#reset")
            is_state(page, "disabled")
            expect(page.locator("#resume")).to_be_hidden()
            hold(page, "#enable")
            is_state(page, "standby")
            expect(page.locator("#alarm-rows tr.active")).to_have_count(0, timeout=WITHIN_MS)
        expect(page.locator("html")).to_have_class("stale", timeout=WITHIN_MS)
        expect(page.locator("#chips")).to_contain_text("no word from the vision PC")
        expect(page.locator("#alarm-line")).to_contain_text("Alarms are not known")
        assert not [each for each in serious(page) if "no word" in each]  # greyed is what is old, not this
        expect(page.locator("#enable")).to_be_disabled()
        page.keyboard.press("Escape")
        expect(page.locator("#stop-told")).to_contain_text("NOT acknowledged", timeout=WITHIN_MS)


def test_a_silent_controller_is_named_and_stop_says_that_nobody_heard(browser: Browser) -> None:
    with served_bench(link_timeout_ms=2_000) as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url) as page:
            is_state(page, "standby")
            bench.silence()
            expect(page.locator("#alarm-rows tr.active").first).to_contain_text("link.", timeout=WITHIN_MS)
            expect(page.locator("#chips .abnormal-1").first).to_be_visible()
            page.locator("#stop").click()
            expect(page.locator("#stop-told")).to_contain_text("hardware stop", timeout=WITHIN_MS)


def test_a_frozen_camera_is_named_with_what_to_do_and_the_page_goes_on_with_it(browser: Browser) -> None:
    with served_bench() as (url, bench):
        bench.eyes.picture_s = 0.1
        with opened(browser, url) as page:
            expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
            bench.eyes.trouble = "link.camera_frozen"
            expect(page.locator("#chips .abnormal-2")).to_have_text("camera ◆ frozen")
            expect(page.locator("#alarm-line")).to_contain_text("start the camera anew")
            told = re.compile(r"This picture is [\d.]+ s old. The camera: frozen")
            expect(page.locator("#no-picture")).to_have_text(told)
            is_state(page, "standby")
            bench.eyes.trouble = None
            expect(page.locator("#no-picture")).to_be_hidden()
            expect(page.locator("#alarm-line")).to_have_text("No alarm")
            expect(page.locator("#chips")).to_contain_text("camera 100.0 /s")


def test_a_token_is_asked_for_and_a_watcher_may_stop_alone(browser: Browser) -> None:
    with served_bench(tokens={Role.LOOK: LOOK, Role.OPERATE: OPERATE}) as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url) as page:
            expect(page.locator("#sign-in")).to_be_visible(timeout=WITHIN_MS)
            expect(page.locator("#chips")).to_have_text("console ▲ wants a token")
            expect(page.locator("#no-picture")).to_have_text("Sign in to see the machine.")
            expect(page.locator("#alarm-line")).to_contain_text("Alarms are not known")
            page.locator("#token").fill("ab" * 32)
            page.locator("#sign-in button").click()
            why = page.locator("#sign-in-why")
            expect(why).to_contain_text("none of this service", timeout=WITHIN_MS)
            expect(why).to_contain_text("docker compose exec vision cat /var/lib/longreach-tokens/operate")
            page.locator("#stop").click()  # who asks for a stop in vain is told so at once
            expect(page.locator("#stop-told")).to_contain_text("(refused.wrong_token)", timeout=WITHIN_MS)
            expect(page.locator("#stop-told")).to_contain_text("hardware stop", timeout=WITHIN_MS)
            page.locator("#token").fill(LOOK.hex())
            page.locator("#sign-in button").click()
            expect(page.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
            is_state(page, "standby")
            expect(page.locator("#whoami")).to_contain_text("look")
            expect(page.locator("#start-local-track")).to_be_disabled()
            page.locator("#stop").click()
            expect(page.locator("#stop-told")).to_contain_text("stopped", timeout=WITHIN_MS)
        with opened(browser, f"{url}#t={OPERATE.hex()}") as page:
            is_state(page, "standby")
            expect(page.locator("#whoami")).to_contain_text("operate")
            assert OPERATE.hex() not in page.url  # it is in no history either


_TOUCHED = "button, select, summary, .named input, label:has([type=checkbox])"
_SMALL = f"""[...document.querySelectorAll('{_TOUCHED}')]
    .map((button) => [button.id || button.textContent, button.getBoundingClientRect().height])
    .filter(([, height]) => height > 0 && height < 44)"""  # too small for a thumb


# what lies under STOP or the alarm line when the focus comes to it, from above and from below
_HIDDEN_FOCUS = f"""async () => {{
    const parts = [...document.querySelectorAll('main :is({_TOUCHED})')];
    const [line, bar] = ['#alarm-line', '#stop-place'].map((place) => document.querySelector(place));
    const hidden = [];
    for (const from of [0, document.body.scrollHeight]) for (const each of parts) {{
        scrollTo(0, from);
        each.focus();
        if (document.activeElement !== each) continue;
        await new Promise(requestAnimationFrame);
        const at = each.getBoundingClientRect();
        const below = at.bottom > bar.getBoundingClientRect().top;
        if (below || at.top < line.getBoundingClientRect().bottom) hidden.push(each.id || each.textContent);
    }}
    return hidden;
}}"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_everybody_can_use_it(browser: Browser, theme: str) -> None:
    phone = {"width": 390, "height": 844}
    with console(browser, color_scheme=theme, viewport={"width": 1440, "height": 900}) as (page, bench, _):
        bench.controller.break_down(FaultCode.JOINT_LIMIT)  # with colours for what is abnormal
        is_state(page, "error_stop")
        expect(page.locator("html")).to_have_attribute("data-theme", theme)
        assert serious(page) == []
        page.set_viewport_size({"width": 1920, "height": 1080})
        for part in ("#eye", "#arm", "#operate", "#strips", "#alarms"):  # at once, without scrolling
            expect(page.locator(part)).to_be_in_viewport(ratio=0.99)
        page.set_viewport_size(phone)
        page.wait_for_timeout(500)
        assert page.evaluate("document.documentElement.scrollWidth") <= phone["width"]
        page.locator("#hand-eye summary").click()
        assert page.evaluate(_SMALL) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= phone["width"]
        assert page.evaluate(_HIDDEN_FOCUS) == []
        place = page.locator("#stop").bounding_box()
        assert place is not None
        assert place["y"] + place["height"] <= phone["height"]  # in view without scrolling
        hold(page, "#reset", by_key=True)
        is_state(page, "disabled")


class AmbiguousWall:
    """`/targets` of a wall that repeats itself: what is clicked is told by a click in the other eye."""

    def __init__(self) -> None:
        self.clicks: list[dict[str, Any]] = []
        self.targets: list[dict[str, Any]] = []

    def answer_for(self, page: Page) -> None:
        page.route("**/targets", self._answer)

    def _answer(self, route: Route) -> None:
        if route.request.method == "GET":
            return route.fulfill(json={"targets": self.targets})
        body = route.request.post_data_json
        self.clicks.append(body)
        if "other_u_px" not in body and "kind" not in body:
            places = (([600.0, 300.0], 1638.2), ([640.0, 300.0], 660.4))
            candidates = [{"other_px": at, "distance_mm": far} for at, far in places]
            told = {"cause": "target.ambiguous", "detail": "two places look alike", "candidates": candidates}
            return route.fulfill(status=422, json=told)
        outline = [[590.0, 290.0], [610.0, 290.0], [600.0, 310.0]]
        kind = body.get("kind", "hole")
        made = {"id": "t1", "kind": kind, "recognised": "hole 45.0 mm", "known": "measured", "aimed": True,
                "std_sight_mm": {"across": 0.2, "along": 0.4}, "distance_mm": 800.0, "reachable": True,
                "carried_mm": 0.0, "outline": outline, "X_CO": {"p_m": [0.1, 0.2, 0.6]}}  # fmt: skip
        self.targets = [made]
        return route.fulfill(status=201, json=made)


def test_a_click_in_the_picture_makes_a_target(browser: Browser) -> None:
    wall = AmbiguousWall()
    with served_bench() as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url, wall.answer_for, viewport={"width": 1440, "height": 900}) as page:
            expect(page.locator("#targets")).to_be_visible(timeout=WITHIN_MS)
            expect(page.locator("#left")).to_have_attribute("data-frame", re.compile("[1-9]"))
            box = page.locator("#left").bounding_box()
            assert box is not None
            page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"])
            expect(page.locator("#answer")).to_contain_text("two places look alike")
            expect(page.locator("#answer")).to_contain_text("Click the same place in the right eye")
            expect(page.locator("#answer")).to_contain_text("by its distance from the camera: 660, 1638 mm")
            expect(page.locator("#right-aims path")).to_have_count(2)
            expect(page.locator("#right-aims text")).to_have_text(["1638", "660"])
            asked = page.locator("#right").bounding_box()
            assert asked is not None
            assert asked["width"] > 0.8 * box["width"]  # what looks alike is told apart in a large picture
            page.locator("#right").click()
            expect(page.locator("#target-rows li.aimed")).to_contain_text("hole 45.0 mm")
            answered = page.locator("#right").bounding_box()
            assert answered is not None
            assert answered["width"] < 0.5 * box["width"]
            expect(page.locator("#aims path.goal")).to_have_count(1)
            expect(page.locator("#answer")).to_contain_text("±0.2 mm across, ±0.4 mm in depth, 800 mm away")
            expect(page.locator("#answer")).to_contain_text(
                "You chose how far it is: 640 mm from the camera."
            )
            expect(page.locator("#candidates button")).to_have_count(0)
            page.locator("#left").focus()  # by keyboard alone
            page.keyboard.press("ArrowLeft")
            page.keyboard.press("Enter")
            expect(page.locator("#right")).to_be_focused()  # from the likeliest place on
            expect(page.locator("#right-aims path.kept")).to_have_count(1)
            page.keyboard.press("ArrowRight")
            page.keyboard.press("Enter")
            eventually(lambda: len(wall.clicks) == 4, page)
            expect(page.locator(".under.asked")).to_have_count(0)
            box = page.locator("#left").bounding_box()
            assert box is not None
            page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"])
            expect(page.locator("#candidates button")).to_have_text(["660", "1638"])
            page.get_by_label("It is 660 mm from the camera").click()
            eventually(lambda: len(wall.clicks) == 6, page)
    first, second, third, keyed, _, chosen = wall.clicks
    assert (chosen["other_u_px"], chosen["other_v_px"]) == (640.0, 300.0)
    assert first["frame_id"] > 0
    assert abs(first["u_px"] - 640.0) < 2.0
    assert abs(first["v_px"] - 180.0) < 2.0
    assert second == first | {"other_u_px": second["other_u_px"], "other_v_px": second["other_v_px"]}
    assert third["u_px"] == 630.0
    assert keyed == third | {"other_u_px": 610.0, "other_v_px": 300.0}
