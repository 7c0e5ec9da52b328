"""Broken couplers whose inputs differ by the function that reads them, or are of another moment."""

from collections.abc import Callable, Iterator
from functools import partial

from tests.conformance.coupler.systematic import BrokenCoupler, broken


def readings() -> Iterator[BrokenCoupler]:
    """Clauses 3.1 and 10.6: one value read in several ways, and of which moment it is."""
    for function in (3, 4, 23):
        for say, bend in (
            ("double words high word first", _high_words_first),
            ("the bytes of each word swapped", _bytes_swapped),
            ("the sign of each word lost", lambda words: [word & 0x7FFF for word in words]),
            ("every word one place late", lambda words: [words[0], *words[:-2], words[-1]]),
        ):  # fmt: skip
            only = partial(_bent_words, function, bend)
            yield broken("3.1", f"{function} delivers {say}", delivers=only)
        rule = frozenset({function})
        yield broken("10.6", f"{function} reads inputs of the request before", of_the_request_before=rule)
    yield broken("10.6", "inputs of the request before", of_the_request_before=frozenset({3, 4, 23}))


def _bent_words(
    which: int, bend: Callable[[list[int]], list[int]], function: int, words: list[int]
) -> list[int]:
    return bend(words) if function == which else words


def _high_words_first(words: list[int]) -> list[int]:
    pairs = words[4:16]
    return [*words[:4], *(word for at in range(0, 12, 2) for word in (pairs[at + 1], pairs[at])), *words[16:]]


def _bytes_swapped(words: list[int]) -> list[int]:
    return [word >> 8 | (word & 0xFF) << 8 for word in words]


MUTANTS = tuple(readings())
