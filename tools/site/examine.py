"""Whether a built site is whole and asks nobody: ``python -m tools.site.examine DIR``; status 1: it is not.

Every link leads to a file of the site and to a place in it, also those that theme and autodoc made.
Pictures, scripts and styles lie beside the pages.
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

_FETCHED = {"script": "src", "img": "src", "source": "src", "iframe": "src", "link": "href"}
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


def main(site: Path) -> int:
    """0: nothing is wrong; 1 with a line each for what is."""
    wrong = list(faults(site))
    print(*wrong, sep="\n", end="\n" if wrong else "")
    pages = len(list(site.rglob("*.html")))
    print(f"{site}: {pages} pages, {len(wrong)} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
