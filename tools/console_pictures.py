"""Pictures of the console in a real browser over the real services: ``python -m tools.console_pictures``.

Starts the three services, drives the procedure by clicks as an operator does, and writes
docs/images/console*.webp. Needs Debian's Chromium (``make browser``) and a machine with little else to do.
"""

import contextlib
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from playwright.sync_api import Page, expect, sync_playwright

from testbed.realtime.launch import prepare
from testbed.realtime.rest_rig import RestRig
from testbed.realtime.supervisor import supervised
from testbed.scenarios.settings import chosen_overrides, with_face
from tests.browser.chromium import hold, is_state

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
MOST_BYTES = 200_000  # of a picture
_WITHIN_MS = 300_000.0
_HEALTHY_S = 120.0
_ARGUMENTS = ["--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
              "--enable-unsafe-swiftshader", "--disable-gpu-compositing"]  # fmt: skip
_DESK: Any = {"width": 1440, "height": 900}
_PHONE: Any = {"width": 390, "height": 844}
_STEPS = ("orientation-adjustment", "local-track", "look-then-move")


def main() -> int:
    """Write the pictures; exit status 1 without a browser."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        print("no Chromium here: make browser", file=sys.stderr)
        return 1
    with services() as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=_ARGUMENTS)
        with contextlib.closing(browser):
            page = browser.new_page(viewport=_DESK, color_scheme="light")
            page.set_default_timeout(_WITHIN_MS)
            page.goto(url)
            drive(page)
            keep(page, "console")
            page.locator("#theme").click()
            keep(page, "console_dark")
            page.locator("#theme").click()
            page.set_viewport_size(_PHONE)
            keep(page, "console_phone")
    return 0


@contextlib.contextmanager
def services() -> Iterator[str]:
    """The address of the console over the standard world of seed 1, with where its arm really is."""
    config = ROOT / "configs"
    with tempfile.TemporaryDirectory() as directory:
        overrides = with_face(chosen_overrides(config, "standard", 1, []), True, True)
        launch = prepare(config, overrides, Path(directory), any_ports=True)
        with supervised(launch.services, launch.directory):
            rig = RestRig(launch.rest_url)
            try:
                rig.wait_healthy(_HEALTHY_S)
            finally:
                rig.close()
            yield launch.rest_url


def drive(page: Page) -> None:
    """The procedure by clicks, to a verdict; the arm in 3D, which costs a core, only then."""
    draw(page, solid=False)
    hold(page, "#enable")
    is_state(page, "standby")
    for kind in _STEPS:
        hold(page, f"#start-{kind}")
        row = page.locator(f'#procedure li[data-kind="{kind}"] .note')
        expect(row).to_contain_text("done", timeout=_WITHIN_MS)
    draw(page, solid=True)
    expect(page.locator("#truth-told")).to_be_visible(timeout=_WITHIN_MS)
    page.locator("#jog-x-plus").hover()


def draw(page: Page, solid: bool) -> None:
    """Have the arm drawn in 3D, or from the side."""
    canvas = page.locator("#scene-canvas")
    if canvas.is_visible() != solid:
        page.locator("#scene-kind").click()
    expect(canvas).to_be_visible(visible=solid, timeout=_WITHIN_MS)


def keep(page: Page, name: str) -> None:
    """Write what the page shows, as good as it fits into the bytes that a picture may have."""
    page.wait_for_timeout(2500)
    shown = cv2.imdecode(np.frombuffer(page.screenshot(timeout=_WITHIN_MS), np.uint8), cv2.IMREAD_COLOR)
    if shown is None:
        raise RuntimeError(f"{name}: the browser's picture cannot be read")
    for quality in range(90, 30, -5):
        _, data = cv2.imencode(".webp", shown, [cv2.IMWRITE_WEBP_QUALITY, quality])
        if len(data) <= MOST_BYTES:
            (IMAGES / f"{name}.webp").write_bytes(data.tobytes())
            print(f"docs/images/{name}.webp: {len(data) / 1e3:.0f} kB, quality {quality}")
            return
    raise RuntimeError(f"{name}: more than {MOST_BYTES} bytes at any quality")


if __name__ == "__main__":
    sys.exit(main())
