"""Consoles in a browser: opened and watched, over a bench; what axe says of them."""

import contextlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import axe_playwright_python
import httpx
from playwright.sync_api import Browser, Page

from tests.browser.chromium import WITHIN_MS, is_state
from tests.vision_pc.shell.rest_server import served_bench
from tests.vision_pc.synthetic_station import Bench

AXE = Path(axe_playwright_python.__file__).parent / "axe.min.js"


@contextlib.contextmanager
def opened(
    browser: Browser,
    url: str,
    before: Callable[[Page], None] = lambda page: None,
    also: str = "blob:",
    **options: Any,
) -> Iterator[Page]:
    """The console at ``url``, alive; fails if anything of another host (but ``also``) was asked for or the
    policy broken.
    """
    foreign: list[str] = []
    with contextlib.closing(browser.new_context(**options)) as context:
        context.set_default_timeout(WITHIN_MS)
        page = context.new_page()
        home = re.escape(str(httpx.URL(url).copy_with(path="", fragment=None)).rstrip("/"))
        page.on("request", lambda asked: foreign.append(asked.url))
        page.on("pageerror", lambda error: foreign.append(f"error: {error}"))
        page.on(
            "console", lambda said: foreign.append(said.text) if "Content Security" in said.text else None
        )
        before(page)
        page.goto(url)
        yield page
    assert [each for each in foreign if not re.match(rf"{home}/|(blob|data):|{re.escape(also)}", each)] == []


@contextlib.contextmanager
def console(browser: Browser, **options: Any) -> Iterator[tuple[Page, Bench, str]]:
    """The console over a bench that is disabled, with pictures twice a second."""
    with served_bench(enabled=False) as (url, bench):
        bench.eyes.picture_s = 0.5
        with opened(browser, url, **options) as page:
            is_state(page, "disabled")
            yield page, bench, url


def eventually(happened: Callable[[], bool], page: Page) -> None:
    for _ in range(600):
        if happened():
            return
        page.wait_for_timeout(100)
    raise AssertionError("did not happen")


def serious(page: Page) -> list[str]:
    """What axe calls serious or critical."""
    page.evaluate(AXE.read_text(encoding="utf-8"))  # the policy lets the debugger alone run what is not ours
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        f"{each['id']}: {node['html'][:120]} {node['failureSummary']}"
        for each in found["violations"]
        if each["impact"] in ("serious", "critical")
        for node in each["nodes"]
    ]
