"""The tokens of a text in turn: what may come, how deep, and where reading goes on behind an error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn, TypeVar

from structured_text import syntax as tree
from structured_text.errors import MOST_ERRORS, Place, TextErrors
from structured_text.lexer import LIBRARY, NAME, RESERVED, WRONG, Token, tokens, why_left_out
from structured_text.library import conversion
from structured_text.types import ELEMENTARY

SECTIONS = {
    "VAR", "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "VAR_TEMP", "VAR_EXTERNAL", "VAR_STAT", "VAR_INST",
}  # fmt: skip
UNITS = {"FUNCTION", "FUNCTION_BLOCK", "PROGRAM"}
TOP = {"", "TYPE", "VAR_GLOBAL", *UNITS}
"""Where reading goes on behind an error outside of units; "" is the end of the text."""
_OUTSIDE = TOP | {f"END_{word}" for word in TOP if word} | {"END_VAR", *SECTIONS}
_DEEPEST, _HIGHEST = 50, 150
"""Brackets and statements within each other; operators upon each other. Python's own stack has an end."""
_Item = TypeVar("_Item")
_Node = TypeVar("_Node", bound=tree.Expression)


class Reader:
    """Reads one text."""

    def __init__(self, file: str, text: str, refusals: TextErrors | None = None) -> None:
        """``refusals``: takes the errors; None: the first ones are raised."""
        self._file, self._refusals, self._tells = file, refusals or TextErrors(), refusals is None
        self._tokens = list(tokens(text))
        self._at = self._deep = 0
        self._ends: frozenset[str] = frozenset()

    @property
    def _peek(self) -> Token:
        return self._tokens[self._at]

    def _next(self) -> Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _accept(self, *words: str) -> Token | None:
        return self._next() if self._peek.word in words else None

    def _expect(self, word: str) -> Token:
        return self._accept(word) or self._wrong(word)

    def _demand(self, holds: object, cause: str, reason: str, line: int = 0) -> None:
        """Refuse unless ``holds``; ``line``: 0 for that of the next token."""
        Place(self._file, line or self._peek.line).demand(holds, cause, reason)

    def _wrong(self, expected: str) -> NoReturn:
        found = self._peek
        why = why_left_out(found.word)
        message = found.text if found.kind == WRONG else f"expected {expected}, found {found.text}{why}"
        follows = not found.word and self._tokens[self._at - 1].kind == WRONG
        follows |= found.word in RESERVED and found.word in self._refusals.lost
        Place(self._file, found.line).refuse("follows" if follows else "syntax", message)

    def _name(self, what: str) -> Token:
        return self._next() if self._peek.kind == NAME else self._wrong(what)

    def _new_name(self) -> Token:
        """A name that is declared."""
        token = self._name("a name")
        word = token.word
        why = (
            "is a reserved word" if word in RESERVED or word in ELEMENTARY
            else "is a standard function" if word in LIBRARY or conversion(word)
            else "begins with two underscores" if word.startswith("__")
            else ""
        )  # fmt: skip
        with self._refusals.kept(token.text):  # what is declared so is read all the same
            self._demand(not why, "reserved", f"{token.text} {why}", token.line)
        return token

    # errors, and how much there may be

    @contextmanager
    def _kept(self, stops: set[str] | frozenset[str], declares: bool = False) -> Iterator[None]:
        """Keep an error of the block; go on at one of the words ``stops``, or behind a semicolon of them."""
        begin, deep = self._at, self._deep
        with self._refusals.kept():
            yield
            return
        if len(self._refusals.errors) >= MOST_ERRORS:
            self._at = len(self._tokens) - 1
        self._deep, self._at = deep, max(self._at, begin + 1)
        while self._peek.word not in stops:
            self._at += 1
        if ";" in stops:
            self._accept(";")
        if declares:
            words = {token.word for token in self._tokens[begin : self._at] if token.kind == NAME}
            self._refusals.lost |= words - RESERVED

    def _until(self, end: str, item: Callable[[], None]) -> None:
        """Items up to the word ``end``, which is taken."""
        while not self._accept(end):
            if self._peek.word in _OUTSIDE:
                self._wrong(end)
            with self._kept({";", *_OUTSIDE}, declares=True):
                item()

    @contextmanager
    def _deeper(self) -> Iterator[None]:
        self._deep += 1
        self._demand(self._deep <= _DEEPEST, "syntax", f"more than {_DEEPEST} brackets or statements deep")
        yield
        self._deep -= 1

    def _made(self, node: _Node, *parts: tree.Expression) -> _Node:
        """``node`` above its ``parts``."""
        node.height = 1 + max(part.height for part in parts)
        self._demand(node.height <= _HIGHEST, "syntax", f"more than {_HIGHEST} operators deep", node.line)
        return node

    def _listed(self, item: Callable[[], _Item], end: str = "") -> list[_Item]:
        """Items with commas between them, and the word ``end`` behind."""
        found = [item()]
        while self._accept(","):
            found.append(item())
        if end:
            self._expect(end)
        return found
