"""The site's Sphinx extension: the navigation, from the links of docs/README.md."""

import re
from pathlib import Path
from posixpath import dirname, join, normpath
from typing import Any

from sphinx.application import Sphinx

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
