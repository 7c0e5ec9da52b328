"""The program's variables as ADS names and describes them: symbols, data types, and their bytes.

Beckhoff, TE1000 "TwinCAT 3 ADS": AdsSymbolEntry, AdsDatatypeEntry. All little-endian.
"""

import contextlib
import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

from structured_text.declarations import BUDGET, FAULT
from structured_text.memory import MemoryView
from structured_text.types import (
    Array,
    Elementary,
    Enumeration,
    Structure,
    StructurePart,
    Type,
    base_of,
    is_scalar,
)

DATA_GROUP = 0x4040  # the PLC's data area; offsets are bytes in the program's memory
_CODES = {  # ADST_…: of the struct module's codes
    "h": 2, "i": 3, "f": 4, "d": 5, "b": 16, "B": 17, "H": 18, "I": 19, "q": 20, "Q": 21, "?": 33,
}  # fmt: skip
_BIG = 65
_LONGEST_NAME = 255  # characters; Python reads no number of thousands of digits
_STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[\s*(-?\d+(?:\s*,\s*-?\d+)*)\s*\]")


class Symbol(NamedTuple):
    """A variable, or a part of one: its full name, its type, and where it lies in the program's memory."""

    name: str
    type: Type
    offset: int

    def part(self, part: StructurePart) -> "Symbol":
        """A part of it, which is a structure."""
        return Symbol(f"{self.name}.{part.name}", part.type, self.offset + part.offset)

    @property
    def entry(self) -> bytes:
        """AdsSymbolEntry."""
        of, name, kind = self.type, _text(self.name), _text(spelled(self.type))
        bounds = _bounds(of)
        tail = name + kind + b"\0" + bounds
        head = struct.pack(
            "<IIIIIHHHHH", 30 + len(tail), DATA_GROUP, self.offset, of.size, code(of), 0, len(bounds) // 8,
            len(name) - 1, len(kind) - 1, 0,
        )  # fmt: skip
        return head + tail


class SymbolTable:
    """All variables of a program's ``memory`` but those that its compiler adds."""

    def __init__(self, memory: MemoryView) -> None:
        whole = memory.type
        assert isinstance(whole, Structure)
        shown = [part for part in whole.fields.values() if part.name not in (FAULT, BUDGET)]
        self._roots = {part.name.upper(): Symbol(part.name, part.type, part.offset) for part in shown}
        self._found: dict[str, Symbol] = {}
        self.symbols = [symbol for root in self._roots.values() for symbol in _parts(root)]
        self.types: dict[str, Type] = {}
        for root in self._roots.values():
            self._collect(root.type)
        self.upload = b"".join(symbol.entry for symbol in self.symbols)
        self.type_upload = b"".join(type_entry(of) for of in self.types.values())

    def find(self, name: str) -> Symbol | None:
        """The variable, part or element ``name``, in any case of letters; None: there is none."""
        key = name.strip().upper()
        if len(key) > _LONGEST_NAME:
            return None
        if key not in self._found:
            found = self._walk(key)
            if found is None:
                return None
            if len(self._found) >= 4096:  # a stranger's spellings are not kept for ever
                self._found.clear()
            self._found[key] = found
        return self._found[key]

    def at(self, offset: int, size: int) -> Symbol | None:
        """The variable that lies there as a whole; an element of an array once it was found by name."""
        known = (each for each in (*self.symbols, *self._found.values()) if each.offset == offset)
        return next((each for each in known if each.type.size == size), None)

    def _walk(self, key: str) -> Symbol | None:
        at, found = 0, None
        while at < len(key):
            step = _STEP.match(key, at)
            if step is None:
                return None
            found = self._roots.get(step[1] or "") if found is None else _part(found, step)
            if found is None:
                return None
            at = step.end()
        return found

    def _collect(self, of: Type) -> None:
        key = spelled(of).upper()
        if key in self.types:
            return
        self.types[key] = of
        if isinstance(of, Array):
            self._collect(of.of)
        elif isinstance(of, Structure):
            for part in of.fields.values():
                self._collect(part.type)


def spelled(of: Type) -> str:
    """The name of a type as TwinCAT spells it."""
    if isinstance(of, Array):
        inside = ",".join(f"{low}..{high}" for low, high in of.bounds)
        return f"ARRAY [{inside}] OF {spelled(of.of)}"
    return of.name


def code(of: Type) -> int:
    """The number of the elementary type of a scalar or of an array of them."""
    inner = of.of if isinstance(of, Array) else of
    return _CODES[base_of(inner).code] if is_scalar(inner) else _BIG


def is_number(of: Type) -> bool:
    """Whether any bytes of its size are a value of it: numbers and bit strings, and arrays of them."""
    inner = of.of if isinstance(of, Array) else of
    return isinstance(inner, Elementary) and inner.name != "BOOL"


def type_entry(of: Type, name: str = "", offset: int = 0) -> bytes:
    """AdsDatatypeEntry of a type, or of a part ``name`` of a structure at ``offset``."""
    own, kind = (_text(name), _text(spelled(of))) if name else (_text(spelled(of)), _text(_base_name(of)))
    parts = b"" if name or not isinstance(of, Structure) else b"".join(
        type_entry(part.type, part.name, part.offset) for part in of.fields.values()
    )  # fmt: skip
    count = len(of.fields) if parts and isinstance(of, Structure) else 0
    bounds = _bounds(of)
    tail = own + kind + b"\0" + bounds + parts
    head = struct.pack(
        "<IIIIIIIIHHHHH", 42 + len(tail), 1, 0, 0, of.size, offset, code(of), 2 if name else 1,
        len(own) - 1, len(kind) - 1, 0, len(bounds) // 8, count,
    )  # fmt: skip
    return head + tail


def _base_name(of: Type) -> str:
    if isinstance(of, Array):
        return spelled(of.of)
    return of.base.name if isinstance(of, Enumeration) else ""


def _bounds(of: Type) -> bytes:
    bounds = of.bounds if isinstance(of, Array) else ()
    return b"".join(struct.pack("<iI", low, high - low + 1) for low, high in bounds)


def _text(words: str) -> bytes:
    return words.encode("latin-1", "replace") + b"\0"


def _parts(symbol: Symbol) -> Iterator[Symbol]:
    """``symbol`` and its parts; not the elements of arrays."""
    yield symbol
    if isinstance(symbol.type, Structure):
        for part in symbol.type.fields.values():
            yield from _parts(symbol.part(part))


def _part(symbol: Symbol, step: re.Match[str]) -> Symbol | None:
    of = symbol.type
    if step[1] is not None:
        return symbol.part(of.fields[step[1]]) if isinstance(of, Structure) and step[1] in of.fields else None
    indices = tuple(int(each) for each in step[2].split(","))
    if not isinstance(of, Array) or len(indices) != len(of.bounds):
        return None
    inside = ",".join(map(str, indices))
    with contextlib.suppress(IndexError):
        return Symbol(f"{symbol.name}[{inside}]", of.of, symbol.offset + of.offset(indices))
    return None
