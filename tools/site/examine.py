"""Whether a built site is whole and asks nobody: ``python -m tools.site.examine DIR``; status 1: it is not.

Every link leads to a file of the site and to a place in it, also those that theme and autodoc made.
Pictures, scripts and styles lie beside the pages. The search finds pages without a server, in a browser where
there is one.
"""

import re
import shutil
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from playwright.sync_api import sync_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
WORDS = {
    "backlash": "docs/glossary.html",
    "pose_servo.position_gain_1_s": "docs/reference/configuration.html",
}
"""What is searched for, and the page that must be found."""
_DEADLINE_MS = 120_000
_FETCHED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "link": "href"}
_ENDED = (
    "/finished|did not match/.test(document.querySelector('#search-results .search-summary')?.textContent)"
)
_NOT_FETCHED = {"canonical", "author", "search", "index", "next", "prev"}
_IN_STYLE = re.compile(r"""(?:url\(|@import)\s*["']?((?:https?:)?//[^"')\s]+)""")


class Links(NamedTuple):
    """What one page refers to, and the places in it."""

    places: set[str]
    links: list[str]
    fetched: list[str]


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found = Links(set(), [], [])

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = dict(attrs)
        self.found.places.update(filter(None, (of.get("id"), of.get("name") if tag == "a" else None)))
        if (target := of.get("href")) and tag == "a":
            self.found.links.append(target)
        relation = set((of.get("rel") or "").split())
        if (target := of.get(_FETCHED.get(tag, ""))) and not relation & _NOT_FETCHED:
            self.found.fetched.append(target)


def read(page: Path) -> Links:
    """The links of one page."""
    reader = _Reader()
    reader.feed(page.read_text(encoding="utf-8"))
    return reader.found


def faults(site: Path) -> Iterator[str]:
    """What is wrong, a line each: links that lead nowhere, and what would be fetched from elsewhere."""
    pages = {path.resolve(): read(path) for path in sorted(site.rglob("*.html"))}
    for page, found in pages.items():
        name = page.relative_to(site.resolve())
        for target in found.fetched:
            if urlsplit(target).netloc:
                yield f"{name}: fetches {target}"
        for target in {*found.links, *found.fetched}:
            if _leads_nowhere(page, target, pages):
                yield f"{name}: {target} leads nowhere"
    for style in site.rglob("*.css"):
        for target in _IN_STYLE.findall(style.read_text(encoding="utf-8")):
            yield f"{style.relative_to(site)}: fetches {target}"


def _leads_nowhere(page: Path, target: str, pages: dict[Path, Links]) -> bool:
    parts = urlsplit(target)
    if parts.scheme or parts.netloc:
        return False  # elsewhere: nobody is asked
    file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if not file.is_file():
        return True
    return bool(parts.fragment) and file in pages and unquote(parts.fragment) not in pages[file].places


def searched(site: Path, browser: str) -> Iterator[str]:
    """What is wrong with the search, tried from the files, without a server and without a network."""
    asked: list[str] = []
    with sync_playwright() as driver:
        shown = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = shown.new_page()
        page.on("request", lambda request: asked.append(request.url))
        for words, wanted in WORDS.items():
            page.goto(f"{(site / 'search.html').resolve().as_uri()}?q={words}", timeout=_DEADLINE_MS)
            page.wait_for_function(_ENDED, timeout=_DEADLINE_MS)
            found = page.eval_on_selector_all("#search-results li a", "links => links.map(link => link.href)")
            if not any(wanted in link for link in found):
                yield f"search: {words} finds {len(found)} pages, {wanted} not among them"
        shown.close()
    for url in asked:
        if urlsplit(url).scheme not in ("file", "data"):
            yield f"search: asks {url}"


def main(site: Path) -> int:
    """0: nothing is wrong; 1 with a line each for what is."""
    wrong = list(faults(site))
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    wrong += searched(site, browser) if browser else []
    print(*wrong, sep="\n", end="\n" if wrong else "")
    pages = len(list(site.rglob("*.html")))
    tried = "search tried from the files" if browser else "search NOT tried: no browser is there"
    print(f"{site}: {pages} pages, {len(wrong)} faults, {tried}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
