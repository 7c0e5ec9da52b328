"""Where the parts of a type lie, against ctypes; what Python reads and writes of them."""

import pytest

from structured_text.program import CompiledProgram
from tests.structured_text.c_layout import as_ctypes, check_offsets
from tests.support.paths import DOCS

MIXED = """
TYPE
    ST_Inner : STRUCT a : BYTE; b : LREAL; c : INT; END_STRUCT
    ST_Odd : STRUCT
        a : USINT; b : ARRAY[0..2] OF ST_Inner; c : BOOL; d : UDINT; e_ : REAL; f : SINT; g : ULINT; h : WORD;
    END_STRUCT
    E_One : (A := 7, B);
END_TYPE
FUNCTION_BLOCK FB_Mixed
VAR_INPUT
    x : BOOL;
END_VAR
VAR_OUTPUT
    y : ULINT := 5;
END_VAR
VAR
    z : ST_Odd;
    k : E_One;
END_VAR
VAR_IN_OUT
    other : ST_Odd;
END_VAR
y := y + other.g;
z.h := 16#1234;
z.b[2].c := -2;
END_FUNCTION_BLOCK
PROGRAM PRG
VAR
    one : BOOL;
    fb : FB_Mixed;
    odd : ST_Odd;
    grid : ARRAY[-1..1, 2..3] OF INT;
END_VAR
odd.g := 3;
fb(x := TRUE, other := odd);
grid[1, 2] := 42;
END_PROGRAM
"""


def test_every_declared_type_lies_as_ctypes_lays_it_out() -> None:
    program = CompiledProgram({"types.st": ((DOCS / "protocol") / "types_twincat_codesys.st").read_text()})
    assert sum(check_offsets(of) for of in program.types.values()) > 100


def test_mixed_types_and_instances_lie_as_ctypes_lays_them_out() -> None:
    program = CompiledProgram({"mixed.st": MIXED})
    assert sum(check_offsets(of) for of in program.types.values()) > 20
    program.run("PRG")
    found = program.memory.PRG
    assert (found.fb.y, found.fb.z.h, found.fb.z.b[2].c, found.odd.g) == (8, 0x1234, -2, 3)
    assert found.grid.numbers.tolist() == [[0, 0], [0, 0], [42, 0]]
    assert found.grid[1, 2] == 42
    assert found.fb.as_dict()["k"] == 0
    same = as_ctypes(found.fb.type).from_address(found.fb.address)
    assert (same.y, same.z.h, same.z.b[2].c) == (8, 0x1234, -2)


def test_python_writes_what_the_program_reads_and_is_refused_what_does_not_fit() -> None:
    program = CompiledProgram({"mixed.st": MIXED})
    found = program.memory.prg
    found.odd.b[1].b = 2.5
    found.grid.numbers[...] = 7
    found.grid[0, 3] = -1
    assert found.as_dict()["grid"] == [[7, 7], [7, -1], [7, 7]]
    copy = program.new("st_odd")
    copy.data[:] = found.odd.data
    assert copy.b[1].b == 2.5
    found.odd = copy
    with pytest.raises(ValueError, match=r"^40000 does not fit INT$"):
        found.grid[0, 3] = 40000
    with pytest.raises(IndexError, match=r"^index 4 is outside 2\.\.3$"):
        found.grid[0, 4] = 1
    with pytest.raises(AttributeError, match=r"^ST_Odd has no gone$"):
        found.odd.gone = 1
    with pytest.raises(ValueError, match="ST_Odd has"):
        found.odd = b"short"
