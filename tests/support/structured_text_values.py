"""Values of IEC 61131-3 structured text: which kinds there are, and what translated statements do with them.

Conversions must fit, signed numbers do not overflow, unsigned ones wrap.
"""

import math
from typing import Any

UNSIGNED = {"USINT": 8, "UINT": 16, "UDINT": 32, "ULINT": 64}
SIGNED = {"SINT": 8, "INT": 16, "DINT": 32, "LINT": 64}
BITS = {"BYTE": 8, "WORD": 16, "DWORD": 32, "LWORD": 64}
ELEMENTARY = {*UNSIGNED, *SIGNED, *BITS, "LREAL", "BOOL"}


class StructuredTextError(Exception):
    """The text is not of the language, or does what a PLC may do in its own way."""


class Runtime:
    """What the translated statements call."""

    @staticmethod
    def wrap(value: Any, kind: str) -> Any:
        if kind in UNSIGNED:
            return value % 2 ** UNSIGNED[kind]
        return Runtime.fit(value, kind)

    @staticmethod
    def fit(value: Any, kind: str) -> Any:
        if kind in ("LREAL", "BOOL"):
            return value
        bits = {**UNSIGNED, **BITS, **SIGNED}[kind]
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if kind in SIGNED else (0, 2**bits)
        if not low <= value < high:
            raise StructuredTextError(f"{value} does not fit {kind}")
        return value

    @staticmethod
    def converted(value: Any, source: str, target: str) -> Any:
        if source == "LREAL":
            value = round(value)  # to the even neighbour, as IEC 60559 and the language have it
        return float(value) if target == "LREAL" else Runtime.fit(value, target)

    @staticmethod
    def divided(a: Any, b: Any) -> Any:
        if isinstance(a, float):
            return a / b
        return int(math.copysign(abs(a) // abs(b), a * b)) if a * b < 0 else a // b

    @staticmethod
    def at(index: int) -> int:
        if index < 0:
            raise StructuredTextError(f"index {index}")
        return index
