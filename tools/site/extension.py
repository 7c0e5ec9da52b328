"""The site's Sphinx extension: navigation from docs/README.md, references from code, the glossary's links."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from posixpath import dirname, join, normpath
from types import MappingProxyType
from typing import Any

from sphinx.application import Sphinx

from tools.site import commands, configuration_keys, gallery, python_interface
from tools.site.glossary import linked

MADE: Mapping[str, Callable[[], str]] = MappingProxyType(
    {
        "configuration": configuration_keys.page,
        "commands": commands.page,
        "python": python_interface.page,
        "gallery": gallery.page,
    }
)
"""What takes the place of ``<!-- site: NAME -->`` in a page."""
_MADE_HERE = re.compile(r"^<!-- site: (\w+) -->$", re.MULTILINE)
_SECTION = re.compile(r"^## (.+)$", re.MULTILINE)
_PAGE_LINK = re.compile(r"\]\(([\w./-]+)\.md(?:#[^)]*)?\)")
BY_READER = "docs/README"
INDEXES = (BY_READER, "docs/decisions/README")
"""Pages whose links are the navigation."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("source-read", _read)
    app.connect("doctree-resolved", linked)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _read(app: Sphinx, docname: str, source: list[str]) -> None:
    text = _MADE_HERE.sub(lambda found: MADE[found[1]](), source[0])
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
