"""Links into the glossary: on every page, a term is a link where it is first used."""

import re
from typing import NamedTuple
from weakref import WeakKeyDictionary

from docutils import nodes
from sphinx.addnodes import desc_signature
from sphinx.application import Sphinx

PAGE = "docs/glossary"
EVERYDAY = {"watch", "path, trajectory", "prior", "residual", "API, response, reported", "grant", "detection"}
"""Rows whose words mostly stand in a sentence as everybody uses them: a link would mislead."""
_NOT_INSIDE = (
    *(nodes.title, nodes.thead, nodes.reference, nodes.target, nodes.literal, nodes.literal_block),
    desc_signature,
)


class Term(NamedTuple):
    """One row of the glossary."""

    words: tuple[str, ...]
    anchor: str
    meaning: str


def terms(doctree: nodes.document) -> list[Term]:
    """The terms of the glossary's page, each row of whose tables is given an anchor."""
    found = []
    for row in doctree.findall(nodes.row):
        if isinstance(row.parent, nodes.thead):
            continue
        cells = [*row.findall(nodes.entry)]
        name, meaning = (cell.astext() for cell in cells[:2])
        anchor = "term-" + re.sub(r"\W+", "-", name.lower()).strip("-")
        if anchor not in cells[0]["ids"]:
            cells[0]["ids"].append(anchor)
        if name not in EVERYDAY:
            words = tuple(re.sub(r" \(.*?\)| b$", "", word) for word in name.split(", "))
            found.append(Term(words, anchor, meaning))
    return found


class Vocabulary(NamedTuple):
    """The glossary, ready to be found in a text."""

    pattern: re.Pattern[str]
    terms: dict[str, Term]


def words(found: list[Term]) -> Vocabulary:
    """All terms, the longest first, singular and plural."""
    by_word = {word.lower(): term for term in found for word in term.words}
    longest_first = sorted(map(re.escape, by_word), key=len, reverse=True)
    return Vocabulary(re.compile(rf"\b({'|'.join(longest_first)})s?\b", re.IGNORECASE), by_word)


def linked(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Link the first use of each term in ``doctree``."""
    if docname == PAGE:
        terms(doctree)  # the anchors
        return
    known = _KEPT.get(app) or _KEPT.setdefault(app, words(terms(app.env.get_doctree(PAGE))))
    where = app.builder.get_relative_uri(docname, PAGE)
    done: set[str] = set()
    for text in list(doctree.findall(nodes.Text)):
        if not inside(text):
            link(text, known, where, done)


_KEPT: WeakKeyDictionary[Sphinx, Vocabulary] = WeakKeyDictionary()


def inside(text: nodes.Text) -> bool:
    """Whether ``text`` is in a title, a link, a literal or a signature: no place for a link."""
    node = text.parent
    while node is not None:
        if isinstance(node, _NOT_INSIDE):
            return True
        node = node.parent
    return False


def link(text: nodes.Text, known: Vocabulary, where: str, done: set[str]) -> None:
    """Make the first use of every term in ``text`` that is not yet ``done`` a link into ``where``."""
    parts: list[nodes.Node] = []
    told = str(text)
    last = 0
    for found in known.pattern.finditer(told):
        term = known.terms[found[1].lower()]
        if term.anchor in done:
            continue
        done.add(term.anchor)
        link = nodes.reference(
            "",
            found[0],
            internal=True,
            refuri=f"{where}#{term.anchor}",
            reftitle=term.meaning,
            classes=["glossary"],
        )
        parts += [nodes.Text(told[last : found.start()]), link]
        last = found.end()
    if parts:
        text.parent.replace(text, [*parts, nodes.Text(told[last:])])
