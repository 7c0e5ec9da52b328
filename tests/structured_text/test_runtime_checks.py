"""What a running program does wrong ends its call with the line, and never the process."""

from pathlib import Path

import pytest

from structured_text.errors import ProgramFaulted
from structured_text.program import CompiledProgram

HEAD = """FUNCTION F_Deep : DINT
VAR_INPUT
    n_in : DINT;
END_VAR
VAR
    a : ARRAY[0..3] OF DINT;
END_VAR
F_Deep := a[n_in];
END_FUNCTION
PROGRAM PRG
VAR
    i, n, m, zero : DINT;  li : LINT;  u : UINT;  f, g : LREAL;  a : ARRAY[1..3, 0..1] OF DINT;
END_VAR
"""
LINE = HEAD.count("\n") + 2

FAULTS = [
    ("i := 4; n := a[i, 0];", "an index is outside of its array"),
    ("i := 0; a[i, 0] := 1;", "an index is outside of its array"),
    ("i := 2; n := a[1, i];", "an index is outside of its array"),
    ("i := -1; n := a[1, i];", "an index is outside of its array"),
    ("n := 1 / zero;", "division by zero"),
    ("n := 1 MOD zero;", "division by zero"),
    ("u := 1 / u;", "division by zero"),
    ("f := 1.0 / f;", "division by zero"),
    ("f := SQRT(f - 1.0);", "a function is not defined for its argument"),
    ("f := LN(f);", "a function is not defined for its argument"),
    ("g := 1.5; f := ACOS(g);", "a function is not defined for its argument"),
    ("f := EXPT(-8.0, 0.5);", "a function is not defined for its argument"),
    ("f := EXPT(g, -1.0);", "a function is not defined for its argument"),
    ("f := EXPT(10.0, 400.0);", "a function is not defined for its argument"),
    ("g := 1.0E308; g := g * 10.0; f := SIN(g);", "a function is not defined for its argument"),
    ("g := 3.0E9; n := LREAL_TO_DINT(g);", "a number does not fit the type that it is converted to"),
    ("n := 2147483647; n := n + 1;", "a signed number overflows"),
    ("n := -2147483648; n := -n;", "a signed number overflows"),
    ("n := -2147483648; n := n / -1;", "a signed number overflows"),
    ("n := 65536; n := n * n;", "a signed number overflows"),
    ("WHILE TRUE DO n := 0; END_WHILE", "a loop does not end"),
    ("REPEAT n := 0; UNTIL FALSE END_REPEAT", "a loop does not end"),
    ("m := 2147483647; FOR n := 0 TO m DO i := 0; END_FOR", "a loop does not end"),
]


@pytest.mark.parametrize(("body", "why"), FAULTS, ids=[body for body, _ in FAULTS])
def test_a_fault_names_its_line_and_ends_the_call(body: str, why: str) -> None:
    program = CompiledProgram({"faulty.st": f"{HEAD}m := 1;\n{body}\nm := 2;\nEND_PROGRAM"})
    with pytest.raises(ProgramFaulted) as caught:
        program.run("PRG")
    assert str(caught.value) == f"faulty.st:{LINE}: {why}"
    assert program.memory.PRG.m != 2
    with pytest.raises(ProgramFaulted):  # and the next call is judged anew
        program.run("PRG")


def test_a_fault_in_a_function_ends_its_callers_too() -> None:
    program = CompiledProgram({"faulty.st": f"{HEAD}n := F_Deep(3) + F_Deep(4);\nm := 2;\nEND_PROGRAM"})
    with pytest.raises(ProgramFaulted, match=r"^faulty\.st:8: an index is outside of its array$"):
        program.run("PRG")
    assert program.memory.PRG.m == 0


def test_machine_code_is_kept_by_text_and_made_anew_where_it_is_spoilt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("structured_text.program.cache_root", lambda: tmp_path)
    text = "PROGRAM PRG VAR n : DINT; END_VAR n := {}; END_PROGRAM"
    for value in (1, 2, 1):
        program = CompiledProgram({"stored.st": text.format(value)})
        program.run("PRG")
        assert program.memory.PRG.n == value
    stored = sorted(tmp_path.rglob("*.o"))
    assert len(stored) == 2
    for each in stored:
        each.write_bytes(b"spoilt")
    program = CompiledProgram({"stored.st": text.format(1)})
    program.run("PRG")
    assert program.memory.PRG.n == 1
