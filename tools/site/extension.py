"""The site's Sphinx extension: navigation from docs/README.md, examples and references from code."""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from posixpath import dirname, join, normpath
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx

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


ROOT = Path(__file__).parents[2]
_SECTION = re.compile(r"^## (.+)$", re.MULTILINE)
_PAGE_LINK = re.compile(r"\]\(([\w./-]+)\.md(?:#[^)]*)?\)")
BY_READER = "docs/README"
INDEXES = (BY_READER, "docs/decisions/README")
"""Pages whose links are the navigation."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("source-read", _insert_generated)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _insert_generated(app: Sphinx, docname: str, source: list[str]) -> None:
    text = source[0]
    if docname == app.config.root_doc:
        text += f"\n\n{_toctree('', [BY_READER])}" + by_reader(Path(app.srcdir))
    elif docname in INDEXES[1:]:
        text += "\n\n" + _toctree("", _pages(text, docname, set()))
    source[0] = text


def by_reader(root: Path) -> str:
    """The navigation: the sections of the documentation's index, each page where it comes first."""
    _, *parts = _SECTION.split((root / f"{BY_READER}.md").read_text(encoding="utf-8"))
    seen = {"README"}
    sections = zip(parts[::2], parts[1::2], strict=True)
    return "".join(_toctree(name, _pages(text, BY_READER, seen)) for name, text in sections)


def _pages(text: str, docname: str, seen: set[str]) -> list[str]:
    """The pages that ``text`` links to and that are not in ``seen``, to which they are added."""
    found = [normpath(join(dirname(docname), target)) for target in _PAGE_LINK.findall(text)]
    new = [page for page in dict.fromkeys(found) if page not in seen]
    seen.update(new)
    return new


def _toctree(caption: str, pages: list[str]) -> str:
    head = f":caption: {caption.partition(':')[0]}\n" if caption else ""
    entries = "\n".join(f"/{page}" for page in pages)
    return f"```{{toctree}}\n:hidden:\n:maxdepth: 1\n{head}\n{entries}\n```\n\n"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
