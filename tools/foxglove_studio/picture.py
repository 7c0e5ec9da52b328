"""A recording as the studio shows it: ``python -m tools.foxglove_studio.picture RECORDING SECONDS``.

Writes docs/images/viewer.webp, ``SECONDS`` after the recording's first message. RECORDING is a merged one;
pictures are in it where the run had ``vision.recording.images=jpeg``. Needs `make viewer` and `make browser`.
"""

import contextlib
import datetime
import shutil
import sys
from pathlib import Path

from mcap.reader import make_reader
from playwright.sync_api import sync_playwright

from tools.console_pictures import keep
from tools.foxglove_studio.serving import address, served

_ARGUMENTS = ["--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
              "--enable-unsafe-swiftshader"]  # fmt: skip
_LOADED_MS = 25_000.0  # plots and drawing come one after the other


def main(recording: Path, after_s: float) -> int:
    """Write the picture; exit status 1 without a browser."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        print("no Chromium here: make browser", file=sys.stderr)
        return 1
    with recording.open("rb") as stream:
        reader = make_reader(stream)
        layout = next(each.data for each in reader.iter_attachments() if each.name == "layout.json")
        begun_ns = next(message.log_time for _, _, message in reader.iter_messages())
    shown = datetime.datetime.fromtimestamp(1e-9 * begun_ns + after_s, datetime.UTC)
    with served(layout.decode(), recording) as origin, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=_ARGUMENTS)
        with contextlib.closing(browser):
            page = browser.new_page(viewport={"width": 1440, "height": 860})
            page.goto(address(origin, at=f"{shown:%FT%T.%fZ}"))
            page.get_by_test_id("CloseIcon").or_(page.locator("[role=tooltip] button")).first.click()
            page.wait_for_timeout(_LOADED_MS)
            keep(page, "viewer")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2])))
