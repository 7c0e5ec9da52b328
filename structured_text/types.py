"""Types and where their parts lie: naturally aligned, little-endian, as TwinCAT and CODESYS have them."""

import math
import struct
from dataclasses import dataclass, field
from typing import Any

BOOL_KIND, SIGNED, UNSIGNED, BITS, FLOAT = "BOOL", "signed", "unsigned", "bits", "real"


@dataclass(frozen=True)
class Elementary:
    """BOOL, a number or a bit string; ``code`` is that of the struct module."""

    name: str
    kind: str
    size: int
    code: str

    @property
    def range(self) -> tuple[float, float]:
        """The least and the greatest number."""
        if self.kind == FLOAT:
            most = (2 - 2.0**-52) * 2.0**1023 if self.size == 8 else (2 - 2.0**-23) * 2.0**127
            return -most, most
        bits = 1 if self.kind == BOOL_KIND else 8 * self.size
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self.kind == SIGNED else (0, (1 << bits) - 1)


_KINDS = (
    (SIGNED, "SINT INT DINT LINT", "bhiq"),
    (UNSIGNED, "USINT UINT UDINT ULINT", "BHIQ"),
    (BITS, "BYTE WORD DWORD LWORD", "BHIQ"),
)
ELEMENTARY: dict[str, Elementary] = {
    name: Elementary(name, kind, 1 << place, codes[place])
    for kind, names, codes in _KINDS
    for place, name in enumerate(names.split())
} | {
    "BOOL": Elementary("BOOL", BOOL_KIND, 1, "?"),
    "REAL": Elementary("REAL", FLOAT, 4, "f"),
    "LREAL": Elementary("LREAL", FLOAT, 8, "d"),
}
BOOL, DINT, LREAL = ELEMENTARY["BOOL"], ELEMENTARY["DINT"], ELEMENTARY["LREAL"]


@dataclass(frozen=True, eq=False)
class Enumeration:
    """Named values of ``base``, by name in capitals."""

    name: str
    base: Elementary
    values: dict[str, int]

    @property
    def size(self) -> int:
        """That of its base."""
        return self.base.size


@dataclass(frozen=True)
class Array:
    """``bounds``: lowest and highest index of each dimension; neighbours differ in the last one."""

    bounds: tuple[tuple[int, int], ...]
    of: "Type"

    @property
    def name(self) -> str:
        """As it is declared."""
        return f"ARRAY[{', '.join(f'{low}..{high}' for low, high in self.bounds)}] OF {self.of.name}"

    @property
    def length(self) -> int:
        """How many elements."""
        return math.prod(high - low + 1 for low, high in self.bounds)

    @property
    def size(self) -> int:
        """In bytes."""
        return self.length * self.of.size

    def offset(self, indices: tuple[int, ...]) -> int:
        """Where an element lies. Raises IndexError."""
        place = 0
        for each, (low, high) in zip(indices, self.bounds, strict=True):
            if not low <= each <= high:
                raise IndexError(f"index {each} is outside {low}..{high}")
            place = place * (high - low + 1) + each - low
        return place * self.of.size

    @property
    def depth(self) -> int:
        """How many arrays and structures lie within each other."""
        return 1 + getattr(self.of, "depth", 0)


@dataclass(frozen=True)
class StructurePart:
    """A part of a structure. ``section``: VAR, VAR_INPUT … of an instance's; ``initial``: None for zeros."""

    name: str
    type: "Type"
    offset: int
    initial: Any
    section: str = "VAR"


@dataclass(eq=False)
class Structure:
    """A STRUCT, or the memory of a function block or program; ``fields`` by name in capitals.

    ``image``: its initial value, once somebody has asked for it.
    """

    name: str
    fields: dict[str, StructurePart] = field(default_factory=dict)
    end: int = 0
    align: int = 1
    is_block: bool = False
    depth: int = 1
    image: bytes = b""

    @property
    def size(self) -> int:
        """In bytes, a whole number of its alignment, at least 1."""
        return max(_aligned(self.end, self.align), 1)

    def add(self, name: str, of: "Type", initial: Any = None, section: str = "VAR") -> StructurePart:
        """Lay out another part behind the last one."""
        offset = _aligned(self.end, align_of(of))
        made = self.fields[name.upper()] = StructurePart(name, of, offset, initial, section)
        self.end, self.align = offset + of.size, max(self.align, align_of(of))
        self.depth = max(self.depth, 1 + getattr(of, "depth", 0))
        return made


Type = Elementary | Enumeration | Array | Structure


def _aligned(at: int, align: int) -> int:
    return -(-at // align) * align


def align_of(of: Type) -> int:
    """What its place is a multiple of: its own size, that of an element, that of the largest part."""
    return of.align if isinstance(of, Structure) else align_of(of.of) if isinstance(of, Array) else of.size


def is_scalar(of: Type) -> bool:
    """Whether a value of it fits a register."""
    return isinstance(of, Elementary | Enumeration)


def base_of(of: Type) -> Elementary:
    """The elementary type that holds a scalar."""
    assert isinstance(of, Elementary | Enumeration)
    return of.base if isinstance(of, Enumeration) else of


def packed(of: Type, value: Any) -> bytes:
    """The bytes of a number, a list of elements or a dict of parts by name in capitals; None: initial."""
    if isinstance(of, Array):
        if value is None:
            return packed(of.of, None) * of.length
        return b"".join(packed(of.of, each) for each in value)
    if isinstance(of, Structure):
        if value is None and of.image:
            return of.image
        data = bytearray(of.size)
        for name, part in of.fields.items():
            given = part.initial if value is None or name not in value else value[name]
            data[part.offset : part.offset + part.type.size] = packed(part.type, given)
        if value is None:
            of.image = bytes(data)
        return bytes(data)
    return struct.pack("<" + base_of(of).code, 0 if value is None else value)
