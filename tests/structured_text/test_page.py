"""The page's table of constructs, row by row, against the compiler."""

import contextlib
import re

import pytest

from structured_text.errors import ProgramFaulted, StructuredTextError
from structured_text.program import CompiledProgram
from tests.support.paths import ROOT

HEAD = """TYPE E_Mode : (Idle, Busy); END_TYPE
FUNCTION F_Out : DINT VAR_INPUT n_in : INT := 1; END_VAR VAR_OUTPUT n_out : DINT; END_VAR
n_out := 5; F_Out := n_in; END_FUNCTION
FUNCTION F_None VAR_IN_OUT n_io : DINT; END_VAR n_io := 5; END_FUNCTION
FUNCTION F_Fault : BOOL F_Fault := 1 / (1 - F_Out()) = 0; END_FUNCTION
"""
DECLARED = (
    "i, n : DINT; k : INT := 3; u : UINT; w : WORD; f : LREAL; x : BOOL; e : E_Mode; a : ARRAY[0..2] OF DINT"
)
# What leaves 5 in n, or the sentence that refuses it.
SNIPPETS = {
    "EXIT": "WHILE TRUE DO n := 5; EXIT; END_WHILE",
    "CONTINUE": "FOR i := 1 TO 6 DO IF i = 3 THEN CONTINUE; END_IF n := n + 1; END_FOR",
    "RETURN": "n := 5; RETURN; n := 6;",
    "REPEAT": "REPEAT n := n + 1; UNTIL n = 5 END_REPEAT",
    "5..8:": "n := 7; CASE n OF 1, 2: n := 1; 5..8: n := 5; END_CASE",
    "VAR_TEMP": "END_VAR VAR_TEMP t : DINT := 5; END_VAR n := t; t := 6;",
    "VAR_IN_OUT": "F_None(n_io := n);",
    "=>": "F_Out(n_in := 2, n_out => n);",
    "[3(0)]": "; b : ARRAY[0..3] OF DINT := [3(0), 5]; END_VAR n := b[3];",
    "(*(*)*)": "(* (* n := 6; *) *) n := 5;",
    "&": "x := TRUE & TRUE; n := SEL(x, 6, 5);",
    "Idle": "e := Busy; n := SEL(e = Idle, 5, 6);",
    "f:=n": "n := 5; f := n; n := LREAL_TO_DINT(f);",
    "f:=1": "f := 1; n := LREAL_TO_DINT(f * 10 / 2);",
    "MAX(a,b,c)": "n := MAX(3, 5, 4);",
    "TRUNC": "n := TRUNC(5.9);",
    "EXPT(f,n)": "n := TO_DINT(EXPT(2.0, k)) - 3;",
    "CASE w": "w := 16#F0; CASE w OF 16#F0: n := 5; END_CASE",
    "n:INT:=1": "n := F_Out() + 4;",
    "no result": "F_None(n);",
    "AND_THEN": "n := 5; IF FALSE AND_THEN F_Fault() THEN n := 6; END_IF",
    "OR_ELSE": "IF TRUE OR_ELSE F_Fault() THEN n := 5; END_IF",
    "{attribute}": "{attribute 'hide'} n := 5;",
    "UDINT_TO_DINT": "n := UDINT_TO_DINT(UDINT#3 - UDINT#5) + 7;",
    "FOR i": "FOR i := 1 TO 4 DO END_FOR n := i;",
    "E_Mode#Idle": "n := TO_DINT(E_Mode#Idle) + 5;",
    "/*": "/* n := 6; */ n := 5;",
    "FOR..TO n": "n := 5; FOR i := 1 TO n DO n := 5; END_FOR",
    "i+1": "n := 5; i := 2147483647; i := i + 1;",
    "STRING": "; s_text : STRING(80); END_VAR ## no strings",
    "TIME": "; tWait : TIME; END_VAR ## no times: count scans, or nanoseconds in a ULINT",
    "TON": "; tWait : TON; END_VAR ## no times: count scans, or nanoseconds in a ULINT",
    "R_TRIG": "; tUp : R_TRIG; END_VAR ## declare that FUNCTION_BLOCK",
    "POINTER": "; p : POINTER TO INT; END_VAR ## no pointers: hand over by VAR_IN_OUT",
    "REF_TO": "; p : REF_TO INT; END_VAR ## no pointers: hand over by VAR_IN_OUT",
    "METHOD": "METHOD M END_METHOD ## no methods: use FUNCTION",
    "AT": "; n_at AT %IW0 : INT; END_VAR ## no addresses: use a global variable",
    "RETAIN": "END_VAR VAR RETAIN n_kept : INT; END_VAR ## nothing outlives the process",
    "VAR_EXTERNAL": "END_VAR VAR_EXTERNAL n_out : INT; END_VAR ## global variables are seen without it",
    "UNION": "; p : UNION; END_VAR ## no unions: convert",
    "JMP": "JMP there; ## no jumps: use EXIT, CONTINUE or RETURN",
    "**": "f := f ** 2.0; ## use EXPT",
    "w.3": "x := w.3; ## expected the name of a member, found 3",
    "INT(0..9)": "; s_range : INT(0..9); END_VAR ## expected ;, found (",
    "WORD_TO_REAL": "f := WORD_TO_REAL(w); ## take a whole number between",
    "BY n": "FOR i := 1 TO 9 BY n DO END_FOR ## expected a constant",
    "a:=b:=c": "n := i := 5; ## expected ;, found :=",
    "n:=u": "k := u; ## expected INT, found UINT",
    "PRG()": "PRG(); ## PRG is called through an instance",
}
_, PAGE = (ROOT / "docs/structured_text.md").read_text(encoding="utf-8").split("| as in | constructs |")
TABLE = [
    (construct, so)
    for so, cell in re.findall(r"^\| ([\w ]+) \| (`.*) \|$", PAGE.split("\n\n")[0], re.MULTILINE)
    for construct in re.findall(r"`([^`]+)`", cell)
]


def test_the_table_has_each_construct_once() -> None:
    assert sorted(construct for construct, _ in TABLE) == sorted(SNIPPETS)


@pytest.mark.parametrize(("construct", "so"), TABLE)
def test_the_construct_is_what_the_table_says(construct: str, so: str) -> None:
    snippet, _, why = SNIPPETS[construct].partition(" ## ")
    begins = "; END_VAR" if "END_VAR" not in snippet else ";" if snippet.startswith("END_VAR") else ""
    text = {"page.st": f"{HEAD}PROGRAM PRG VAR {DECLARED}{begins}\n{snippet}\nEND_PROGRAM"}
    if so == "refused":
        with pytest.raises(StructuredTextError, match=f"^[^\n]*{re.escape(why)}$"):
            CompiledProgram(text)
        return
    program = CompiledProgram(text)
    with contextlib.suppress(ProgramFaulted):  # i + 1 faults, as the table says
        program.run("PRG")
    assert program.memory.PRG.n == 5
