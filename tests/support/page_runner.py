"""A page's own commands, run as they stand, and what the page says that they print."""

import re
from typing import NamedTuple

_FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")


class Block(NamedTuple):
    """A block in ``language`` (sh, python), and the lines that the page says it prints."""

    language: str
    text: str
    printed: tuple[str, ...]


def blocks(page: str) -> list[Block]:
    """The blocks of a page that can be run, in order, each with the ``text`` block behind it, if any."""
    found: list[Block] = []
    for language, text in _FENCED.findall(page):
        if language == "text":
            assert found, f"nothing is run before {text!r}"
            found[-1] = found[-1]._replace(printed=tuple(text.splitlines()))
        else:
            found.append(Block(language, text, ()))
    return found


def missing(printed: tuple[str, ...], output: str, tolerance: float) -> list[str]:
    """The lines of ``printed`` that ``output`` has nowhere: same words, numbers within ``tolerance``.

    A terminal breaks lines anywhere: blanks are compared as one.
    """
    said = " ".join(output.split())
    return [line for line in printed if not _is_in(" ".join(line.split()), said, tolerance)]


def _is_in(line: str, said: str, tolerance: float) -> bool:
    words = [re.escape(word) for word in _NUMBER.split(line)]
    wanted = [float(number) for number in _NUMBER.findall(line)]
    pattern = re.compile(f"({_NUMBER.pattern})".join(words))
    return any(
        all(abs(float(is_) - should) <= tolerance for is_, should in zip(found.groups(), wanted, strict=True))
        for found in pattern.finditer(said)
    )
