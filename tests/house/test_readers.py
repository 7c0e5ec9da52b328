"""Every page says in its first lines for whom it is, as docs/README.md has it, and where its words are."""

import functools
import os
import re
from pathlib import Path

from tests.support.paths import DOCS

PAGES = sorted({*DOCS.glob("*.md"), *DOCS.glob("how_to/*.md")} - {DOCS / "README.md"})
EVERYBODY = "Everybody"


@functools.cache
def readers() -> dict[Path, list[str]]:
    """Of every page that docs/README.md links, the headings under which it does, without what they do."""
    found: dict[Path, list[str]] = {}
    for section in (DOCS / "README.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        who = section.partition("\n")[0].partition(":")[0].strip()
        for target in re.findall(r"\]\(([^)#]+\.md)(?:#[^)]*)?\)", section):
            known = found.setdefault((DOCS / target).resolve(), [])
            if who not in known:
                known.append(who)
    return found


def in_a_sentence(who: str) -> str:
    """``who`` as it stands in the middle of one."""
    return who if who.startswith("PLC") else who.lower()


def line_for(page: Path) -> str:
    """What stands under the title of ``page``."""
    who = readers().get(page.resolve(), [])
    assert who, f"docs/README.md has no link to {page.relative_to(DOCS)}"
    told = "everybody" if EVERYBODY in who else ", ".join(map(in_a_sentence, who))
    glossary = os.path.relpath(DOCS / "glossary.md", page.parent)
    words = "" if page.name == "glossary.md" else f" Words: [glossary]({glossary})."
    return f"For: {told}.{words}"


def test_the_line_under_the_title_names_the_readers() -> None:
    heads = {page: page.read_text(encoding="utf-8").split("\n", 4)[:4] for page in PAGES}
    assert [page for page, head in heads.items() if not head[0].startswith("# ")] == []
    under = {page: ["", line_for(page), ""] for page in PAGES}
    assert {page: head[1:] for page, head in heads.items()} == under


def test_there_are_pages_for_every_reader() -> None:
    told = {who for found in readers().values() for who in found}
    assert told == {"Researcher", "PLC engineer", "Vision engineer", "Operator", EVERYBODY}
    assert len(PAGES) > 30
