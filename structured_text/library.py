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
    base_of,
)

# Functions of real numbers, with the smallest and the largest argument that they are defined for.
REAL_FUNCTIONS: dict[str, tuple[float | None, float | None]] = {
    "SQRT": (0.0, None),
    "LN": (5e-324, None), "LOG": (5e-324, None), "EXP": (None, None), "SIN": (None, None),
    "COS": (None, None), "TAN": (None, None), "ASIN": (-1.0, 1.0), "ACOS": (-1.0, 1.0), "ATAN": (None, None),
}  # fmt: skip
SHIFTS = ("SHL", "SHR", "ROL", "ROR")
_NUMBERS = (SIGNED, UNSIGNED, FLOAT)
# How many arguments, and of which kinds the values among them are.
_TAKES: dict[str, tuple[int, tuple[str, ...]]] = {
    "ABS": (1, _NUMBERS), "MIN": (2, _NUMBERS), "MAX": (2, _NUMBERS), "LIMIT": (3, _NUMBERS),
    "EXPT": (2, (FLOAT,)),
    "SEL": (3, (*_NUMBERS, BITS, BOOL_KIND)),
    **dict.fromkeys(REAL_FUNCTIONS, (1, (FLOAT,))), **dict.fromkeys(SHIFTS, (2, (BITS,))),
}  # fmt: skip


class NotSo(Exception):
    """A standard function is not called so; the text says why."""


def conversion(word: str) -> tuple[Elementary | None, Elementary] | None:
    """From which type, None for any, to which one the conversion ``word`` leads; None for no conversion."""
    if word in ("TRUNC", "TRUNC_INT"):
        return None, ELEMENTARY["INT" if word == "TRUNC_INT" else "DINT"]
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
    return word in _TAKES or conversion(word) is not None


def assumed(word: str, expect: Type | None) -> Type | None:
    """What a number without a type is taken for as an argument, where no other argument decides."""
    converts = conversion(word)
    return converts[0] if converts else LREAL if _TAKES[word][1] == (FLOAT,) else expect


def argument_type(word: str, place: int, kind: Type | None) -> Type | None:
    """What a number without a type is taken for as argument ``place``, the others being of ``kind``."""
    return BOOL if (word, place) == ("SEL", 0) else DINT if word in SHIFTS and place == 1 else kind


def result_type(word: str, given: list[Type]) -> Type:
    """The type of the result. Raises NotSo when ``word`` does not take ``given``."""
    converts = conversion(word)
    count, kinds = (1, _TAKES["SEL"][1]) if converts else _TAKES[word]
    fits = len(given) == count or (word in ("MIN", "MAX") and len(given) > count)
    _demand(fits, f"{word} takes {count} arguments, {len(given)} are given")
    values = given[1:] if word == "SEL" else given[:1] if word in SHIFTS else given
    names = ", ".join("nothing" if each is None else each.name for each in values)
    if converts:
        source, target = converts
        takes = "a number" if source is None else source.name
        _demand(source in (None, values[0]) and _is_of(values[0], kinds), f"{word} takes {takes}")
        way = "the standard keeps the bits, TwinCAT the value: take a whole number between"
        _demand({base_of(values[0]).kind, target.kind} != {FLOAT, BITS}, f"{word}: {way}")
        return target
    if word in SHIFTS:
        shifts = _is_of(values[0], kinds) and _is_of(given[1], (SIGNED, UNSIGNED))
        _demand(shifts, f"{word} takes a bit string and a whole number")
    _demand(word != "SEL" or given[0] == BOOL, "SEL chooses by a BOOL")
    _demand(all(each == values[0] for each in values), f"{word} takes values of one type, found {names}")
    _demand(
        _is_of(values[0], kinds) and (word == "SEL" or values[0] in ELEMENTARY.values()), f"{word} of {names}"
    )
    return values[0]


def _demand(holds: bool, why: str) -> None:
    if not holds:
        raise NotSo(why)


def _is_of(kind: Type, kinds: tuple[str, ...]) -> bool:
    return isinstance(kind, Elementary | Enumeration) and base_of(kind).kind in kinds
