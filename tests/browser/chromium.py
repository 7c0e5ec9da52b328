"""Debian's Chromium under Playwright (`make browser`), and what an operator does in it."""

import contextlib
import shutil
from collections.abc import Iterator

from playwright.sync_api import Browser, Page, Request, expect, sync_playwright

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ABSENT = "no Chromium here (make browser): the console was NOT tried"
WITHIN_MS = 60_000.0  # this machine may be busy
_HOLD_MS = 800
# Without a graphics processor a drawing in 3D takes a core: the page then draws the arm from the side.
_ARGUMENTS = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--disable-software-rasterizer"]


@contextlib.contextmanager
def launched() -> Iterator[Browser]:
    """A browser; what it expects may take a while."""
    expect.set_options(timeout=WITHIN_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS, timeout=120_000)
        with contextlib.closing(browser):
            yield browser


def is_state(page: Page, state: str, within_ms: float = WITHIN_MS) -> None:
    """Wait for this state of the axes group."""
    expect(page.locator("#ladder li.on")).to_have_attribute("data-state", state, timeout=within_ms)


def hold(page: Page, button: str, by_key: bool = False) -> None:
    """Hold a button for as long as it wants to be held, until the page has sent a command.

    While a busy machine has the page hear nothing, its buttons are off: then once more.
    """
    sent: list[str] = []

    def note_command(asked: Request) -> None:
        if asked.method == "POST":
            sent.append(asked.url)

    page.on("request", note_command)
    try:
        for _ in range(20):
            expect(page.locator(button)).to_be_enabled(timeout=WITHIN_MS)
            if by_key:
                reach(page, button)
                page.keyboard.down("Enter")
            else:
                page.locator(button).hover()
                page.mouse.down()
            page.wait_for_timeout(_HOLD_MS)
            if by_key:
                page.keyboard.up("Enter")
            else:
                page.mouse.up()
            for _ in range(20):
                if sent:
                    return
                page.wait_for_timeout(100)
    finally:
        page.remove_listener("request", note_command)
    raise AssertionError(f"{button} was held, and nothing was sent")


def reach(page: Page, element: str) -> None:
    """Press Tab until the focus is on it."""
    for _ in range(100):
        if page.evaluate("selector => document.activeElement.matches(selector)", element):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{element} is not reached by Tab")


def note(page: Page, kind: str, words: str) -> None:
    """Wait until the procedure's row says so."""
    row = page.locator(f'#procedure li[data-kind="{kind}"] .note')
    expect(row).to_contain_text(words, timeout=WITHIN_MS)
