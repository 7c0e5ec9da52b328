"""The layout of a type as C's compiler has it, to be compared with the compiler's own."""

import ctypes
from typing import Any

from structured_text.types import Array, Structure, Type, base_of, is_scalar

CODES = {
    "b": ctypes.c_int8,
    "h": ctypes.c_int16,
    "i": ctypes.c_int32,
    "q": ctypes.c_int64,
    "?": ctypes.c_bool,
    "B": ctypes.c_uint8,
    "H": ctypes.c_uint16,
    "I": ctypes.c_uint32,
    "Q": ctypes.c_uint64,
    "f": ctypes.c_float,
    "d": ctypes.c_double,
}


def as_ctypes(of: Type) -> Any:
    """The same type as C's compiler lays it out."""
    if is_scalar(of):
        return CODES[base_of(of).code]
    if isinstance(of, Array):
        return as_ctypes(of.of) * of.length
    assert isinstance(of, Structure)
    fields = [(part.name, as_ctypes(part.type)) for part in of.fields.values()]
    return type(of.name, (ctypes.Structure,), {"_fields_": fields})


def check_offsets(of: Type) -> int:
    """How many parts lie where ctypes has them; all of them do."""
    made = as_ctypes(of)
    assert ctypes.sizeof(made) == of.size
    if isinstance(of, Array):
        return check_offsets(of.of)
    if not isinstance(of, Structure):
        return 1
    for part in of.fields.values():
        assert getattr(made, part.name).offset == part.offset, f"{of.name}.{part.name}"
    return sum(check_offsets(part.type) for part in of.fields.values())
