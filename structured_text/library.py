"""Standard functions and conversions: what they take and give; ``values`` computes them."""

from structured_text.types import (
    BITS,
    BOOL,
    BOOL_KIND,
    DINT,
    ELEMENTARY,
    FLOAT,
    LREAL,
    SIGNED,
    UNSIGNED,
    Elementary,
    Enumeration,
    Type,
)

# Functions of real numbers, with the smallest and the largest argument that they are defined for.
REAL_FUNCTIONS: dict[str, tuple[float | None, float | None]] = {
    "SQRT": (0.0, None),
    "LN": (5e-324, None), "LOG": (5e-324, None), "EXP": (None, None), "SIN": (None, None),
    "COS": (None, None), "TAN": (None, None), "ASIN": (-1.0, 1.0), "ACOS": (-1.0, 1.0), "ATAN": (None, None),
}  # fmt: skip
SHIFTS = ("SHL", "SHR", "ROL", "ROR")
_COUNTS = {"ABS": 1, "MIN": 2, "MAX": 2, "LIMIT": 3, "SEL": 3, "EXPT": 2}
_NUMBERS = (SIGNED, UNSIGNED, FLOAT)


class NotSo(Exception):
    """A standard function is not called so; the text says why."""


def conversion(word: str) -> tuple[Elementary | None, Elementary] | None:
    """From which type, None for any, to which one the conversion ``word`` leads; None for no conversion."""
    source, between, target = word.rpartition("TO_")
    if not between or target not in ELEMENTARY:
        return None
    if source == "":
        return None, ELEMENTARY[target]
    if source.endswith("_") and source[:-1] in ELEMENTARY:
        return ELEMENTARY[source[:-1]], ELEMENTARY[target]
    return None


def is_known(word: str) -> bool:
    """Whether ``word`` is a standard function that is compiled here."""
    return word in REAL_FUNCTIONS or word in SHIFTS or word in _COUNTS or conversion(word) is not None


def assumed(word: str, expect: Type | None) -> Type | None:
    """What a number without a type is taken for as an argument, where no other argument decides."""
    converts = conversion(word)
    if converts is not None:
        return converts[0]
    if word in REAL_FUNCTIONS or word == "EXPT":
        return LREAL
    return expect


def argument_type(word: str, place: int, kind: Type | None) -> Type | None:
    """What a number without a type is taken for as argument ``place``, the others being of ``kind``."""
    if word == "SEL" and place == 0:
        return BOOL
    if word in SHIFTS and place == 1:
        return DINT
    return kind


def result_type(word: str, given: list[Type | None]) -> Type:
    """The type of the result. Raises NotSo when ``word`` does not take ``given``."""
    converts = conversion(word)
    count = 1 if converts or word in REAL_FUNCTIONS else 2 if word in SHIFTS else _COUNTS[word]
    if len(given) != count:
        raise NotSo(f"{word} takes {count} arguments, {len(given)} are given")
    if converts:
        return _converted(word, converts, given[0])
    first = given[0]
    if word in SHIFTS:
        by = given[1]
        if not _of(first, BITS) or not _of(by, SIGNED, UNSIGNED):
            raise NotSo(f"{word} takes a bit string and a whole number")
        assert first is not None
        return first
    values = given[1:] if word == "SEL" else given
    if word == "SEL" and first != BOOL:
        raise NotSo("SEL chooses by a BOOL")
    if any(each != values[0] for each in values) or values[0] is None:
        names = ", ".join("nothing" if each is None else each.name for each in values)
        raise NotSo(f"{word} takes values of one type, found {names}")
    needs = (FLOAT,) if word in REAL_FUNCTIONS or word == "EXPT" else _NUMBERS
    if word != "SEL" and not _of(values[0], *needs):
        raise NotSo(f"{word} of {values[0].name}")
    if word == "SEL" and not isinstance(values[0], Elementary | Enumeration):
        raise NotSo(f"SEL of {values[0].name}")
    return values[0]


def _of(kind: Type | None, *kinds: str) -> bool:
    return isinstance(kind, Elementary) and kind.kind in kinds


def _converted(word: str, converts: tuple[Elementary | None, Elementary], found: Type | None) -> Type:
    source, target = converts
    if (
        found is None
        or (source is not None and found != source)
        or not isinstance(found, Elementary | Enumeration)
    ):
        raise NotSo(f"{word} takes {'a number' if source is None else source.name}")
    kind = found.base.kind if isinstance(found, Enumeration) else found.kind
    pairs = {kind, target.kind}
    if FLOAT in pairs and (BITS in pairs or BOOL_KIND in pairs):
        raise NotSo(f"{word}: {found.name} is no number")
    return target
