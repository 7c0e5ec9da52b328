"""A typed view of a program's memory: what Python reads and writes of it."""

import ctypes
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from structured_text.types import FLOAT, Array, Structure, Type, base_of, is_scalar, packed


class MemoryView:
    """A structure, an instance or an array in memory; names ignore case, indices are those of the language.

    ``type``: what it is a view of; ``address``: of its first byte. Scalars are read and written as numbers,
    an array of scalars as ``numbers``. It keeps its memory alive.
    """

    __slots__ = ("_owner", "address", "type")
    type: Any
    address: int

    def __init__(self, of: Type, address: int, owner: object) -> None:
        object.__setattr__(self, "type", of)
        object.__setattr__(self, "address", address)
        object.__setattr__(self, "_owner", owner)

    @property
    def data(self) -> Any:
        """All its bytes, as a memoryview that can be written to."""
        return memoryview((ctypes.c_uint8 * self.type.size).from_address(self.address)).cast("B")

    @property
    def numbers(self) -> npt.NDArray[Any]:
        """An array of scalars as numpy sees it, in the shape of its bounds; not copied."""
        of = self.type
        if not (isinstance(of, Array) and is_scalar(of.of)):
            raise TypeError(f"{of.name} is no array of numbers")
        shape = [high - low + 1 for low, high in of.bounds]
        return np.frombuffer(self.data, np.dtype("<" + base_of(of.of).code)).reshape(shape)

    def clear(self) -> None:
        """Give everything its initial value."""
        self.data[:] = packed(self.type, None)

    def as_dict(self) -> Any:
        """Plain data: dicts of structures, lists of arrays."""
        of = self.type
        if isinstance(of, Structure):
            return {part.name: _plain(getattr(self, part.name)) for part in of.fields.values()}
        return self.numbers.tolist() if is_scalar(of.of) else [_plain(each) for each in self]

    def __getattr__(self, name: str) -> Any:
        part = self._part(name)
        return read(part.type, self.address + part.offset, self._owner)

    def __setattr__(self, name: str, value: Any) -> None:
        part = self._part(name)
        write(part.type, self.address + part.offset, value)

    def __getitem__(self, index: int | tuple[int, ...]) -> Any:
        return read(self.type.of, self._element(index), self._owner)

    def __setitem__(self, index: int | tuple[int, ...], value: Any) -> None:
        write(self.type.of, self._element(index), value)

    def __len__(self) -> int:
        return self.type.length  # type: ignore[no-any-return]

    def __iter__(self) -> Iterator[Any]:
        of = self.type
        for at in range(0, of.size, of.of.size):
            yield read(of.of, self.address + at, self._owner)

    def _part(self, name: str) -> Any:
        of = self.type
        if not isinstance(of, Structure) or name.upper() not in of.fields:
            raise AttributeError(f"{of.name} has no {name}")
        return of.fields[name.upper()]

    def _element(self, index: int | tuple[int, ...]) -> int:
        of = self.type
        if not isinstance(of, Array):
            raise TypeError(f"{of.name} has no elements")
        return int(self.address + of.offset(index if isinstance(index, tuple) else (index,)))


def new(of: Type) -> MemoryView:
    """A view of memory of its own, with initial values."""
    owner = ctypes.create_string_buffer(of.size + 16)
    address = -(-ctypes.addressof(owner) // 16) * 16
    made = MemoryView(of, address, owner)
    made.clear()
    return made


def _plain(value: Any) -> Any:
    return value.as_dict() if isinstance(value, MemoryView) else value


def read(of: Type, address: int, owner: object) -> Any:
    """The number that lies there, or a view that keeps ``owner`` alive."""
    if not is_scalar(of):
        return MemoryView(of, address, owner)
    return _CTYPES[base_of(of).code].from_address(address).value


def write(of: Type, address: int, value: Any) -> None:
    """Leave a number, bytes or what a view shows. Raises ValueError for what does not fit."""
    if isinstance(value, MemoryView):
        value = bytes(value.data)
    elif isinstance(of, Array) and is_scalar(of.of) and not isinstance(value, bytes | bytearray | memoryview):
        value = np.asarray(value, np.dtype("<" + base_of(of.of).code)).tobytes()
    if isinstance(value, bytes | bytearray | memoryview):
        if len(value) != of.size:
            raise ValueError(f"{of.name} has {of.size} bytes, {len(value)} are given")
        ctypes.memmove(address, bytes(value), of.size)
        return
    base, (low, high) = base_of(of), base_of(of).range
    if base.kind != FLOAT and not low <= value <= high:
        raise ValueError(f"{value} does not fit {of.name}")
    _CTYPES[base.code].from_address(address).value = value


_CTYPES: dict[str, Any] = {
    "b": ctypes.c_int8, "h": ctypes.c_int16, "i": ctypes.c_int32, "q": ctypes.c_int64,
    "B": ctypes.c_uint8, "H": ctypes.c_uint16, "I": ctypes.c_uint32, "Q": ctypes.c_uint64,
    "?": ctypes.c_bool, "f": ctypes.c_float, "d": ctypes.c_double,
}  # fmt: skip


def ctype_of(of: Type) -> Any:
    """What ctypes hands over for a scalar."""
    return _CTYPES[base_of(of).code]
