"""Every construct of the language, against a value computed by hand."""

import pytest

from structured_text.program import CompiledProgram

TYPES = """
TYPE
    E_Mode : (Idle, Busy := 5, Done);
    E_Small : (Zero, One) USINT;
    ST_Pair : STRUCT
        a : LREAL := 1.5;
        b : ARRAY[1..3] OF INT := [7, 8, 9];
    END_STRUCT
    T_Grid : ARRAY[0..1, -1..1] OF DINT;
    T_Four : ARRAY[0..3] OF DINT;
END_TYPE
VAR_GLOBAL CONSTANT
    COUNT_N : INT := 2 * 3 - 1;
    TABLE : T_Grid := [[1, 2, 3], [4, 5, 6]];
    FLAT : T_Grid := [1, 2, 3, 4, 5, 6];
    PAIR : ST_Pair := (a := 2.5);
    MODES : ARRAY[0..1] OF E_Mode := [E_Mode.Busy, E_Mode.Done];
END_VAR
FUNCTION F_Double : DINT
VAR_INPUT
    n_in : DINT;
END_VAR
F_Double := n_in * 2;
END_FUNCTION
FUNCTION F_Split : BOOL
VAR_INPUT
    n_in : DINT;
END_VAR
VAR_OUTPUT
    n_quotient, n_rest : DINT;
END_VAR
VAR_IN_OUT
    n_calls : DINT;
END_VAR
n_quotient := n_in / 10;
n_rest := n_in MOD 10;
n_calls := n_calls + 1;
F_Split := n_rest = 0;
END_FUNCTION
FUNCTION F_Sum : LREAL
VAR_INPUT
    pair_in : ST_Pair;
END_VAR
F_Sum := pair_in.a + INT_TO_LREAL(pair_in.b[1] + pair_in.b[3]);
END_FUNCTION
VAR_GLOBAL
    GLOBAL_N : DINT;
END_VAR
FUNCTION F_Outputs : BOOL
VAR_OUTPUT
    n_kept : DINT := 4; n_unset : DINT; pair_out : ST_Pair; a_out : T_Four := [1, 2, 3, 0];
END_VAR
n_kept := n_kept + 1;
a_out[0] := a_out[0] * 2;
pair_out.b[2] := pair_out.b[2] + 1;
END_FUNCTION
FUNCTION F_Sees : DINT
VAR_OUTPUT
    n_out : DINT;
END_VAR
n_out := 1;
F_Sees := GLOBAL_N;
END_FUNCTION
FUNCTION F_Turn : BOOL
VAR_INPUT
    a_in : T_Four;
END_VAR
VAR_OUTPUT
    a_out : T_Four;
END_VAR
a_out[0] := a_in[3];
a_out[3] := a_in[0];
END_FUNCTION
FUNCTION F_Both : BOOL
VAR_IN_OUT
    n_io : DINT;
END_VAR
VAR_OUTPUT
    n_out : DINT;
END_VAR
n_out := 3;
n_io := n_io + 1;
END_FUNCTION
FUNCTION F_Local : DINT
VAR
    n : DINT := 7;
    a : T_Four := [10, 0, 0, 40];
END_VAR
F_Both(n_io := n, n_out => n);
F_Turn(a_in := a, a_out => a);
F_Local := n * 1000 + a[0] * 100 + a[3] / 10;
END_FUNCTION
FUNCTION_BLOCK FB_Counter
VAR_INPUT
    n_by : DINT := 1;
END_VAR
VAR_OUTPUT
    n_count : DINT;
END_VAR
VAR
    n_calls : DINT;
END_VAR
n_count := n_count + n_by;
n_calls := n_calls + 1;
END_FUNCTION_BLOCK
"""
VARIABLES = (
    "i, j, n, m : DINT; u : UINT; us : USINT; ul : ULINT; w : WORD; d : DWORD; f, g : LREAL;"
    "rr : REAL; x, y : BOOL;"
    "e : E_Mode; p, q : ST_Pair; t : T_Grid; a : T_Four := [10, 20, 30, 40]; c : FB_Counter;"
    "cs : ARRAY[1..2] OF FB_Counter; li : LINT; b : BYTE; si : SINT; ix : INT; es : E_Small;"
)

CASES = [
    # arithmetic, by precedence
    ("n := 2 + 3 * 4 - 10 / 3;", "n", 11),
    ("n := (2 + 3) * 4;", "n", 20),
    ("n := -7 / 2;", "n", -3),
    ("n := -7 MOD 2;", "n", -1),
    ("n := 7 - 2 - 1;", "n", 4),
    ("u := 0; u := u - 1;", "u", 65535),
    ("us := 200; us := us + 100;", "us", 44),
    ("f := 7.0 / 2.0;", "f", 3.5),
    ("f := 1.0E-3 * 2.0;", "f", 0.002),
    ("f := -(-1.5);", "f", 1.5),
    ("m := 3; n := -m;", "n", -3),
    ("n := +5;", "n", 5),
    ("rr := 1.5; rr := rr * rr;", "rr", 2.25),
    ("ul := 16#FFFF_FFFF_FFFF_FFFF;", "ul", 2**64 - 1),
    ("n := 2#1010 + 8#17;", "n", 25),
    ("li := LINT#-5;", "li", -5),
    ("n := DINT#16#10;", "n", 16),
    ("f := LREAL#2.0;", "f", 2.0),
    # comparisons and logic
    ("x := 3 > 2;", "x", True),
    ("x := 3 <= 2;", "x", False),
    ("x := 2 <> 2;", "x", False),
    ("x := 2.0 >= 2.0;", "x", True),
    ("x := TRUE AND NOT FALSE;", "x", True),
    ("x := TRUE XOR TRUE;", "x", False),
    ("x := FALSE OR TRUE AND FALSE;", "x", False),
    ("x := 1 < 2 = TRUE;", "x", True),
    ("w := WORD#16#F0F0 AND WORD#16#FF00;", "w", 0xF000),
    ("w := NOT WORD#16#00FF;", "w", 0xFF00),
    ("d := DWORD#1 OR 16#8000_0000;", "d", 0x80000001),
    ("x := BOOL#1;", "x", True),
    ("ul := 1; x := ul > 0;", "x", True),
    # statements
    ("IF n > 0 THEN m := 1; ELSIF n = 0 THEN m := 2; ELSE m := 3; END_IF", "m", 2),
    ("IF n > 0 THEN m := 1; ELSE m := 3; END_IF;", "m", 3),
    ("n := 7; CASE n OF 1, 2: m := 1; 5..8: m := 2; ELSE m := 3; END_CASE", "m", 2),
    ("n := -1; CASE n OF -2..-1: m := 4; 0: m := 5; END_CASE;", "m", 4),
    ("CASE n OF 1: m := 1; ELSE m := 9; END_CASE", "m", 9),
    ("e := E_Mode.Busy; CASE e OF E_Mode.Idle: m := 1; E_Mode.Busy: m := 2; END_CASE", "m", 2),
    ("FOR i := 1 TO 4 DO n := n + i; END_FOR", "n", 10),
    ("FOR i := 9 TO 0 BY -3 DO n := n * 10 + i; END_FOR", "n", 9630),
    ("FOR i := 3 TO 2 DO n := 1; END_FOR", "n", 0),
    ("FOR us := 250 TO 255 DO n := n + 1; END_FOR", "n", 6),
    ("m := 3; FOR i := 1 TO m BY 2 DO n := n + i; m := 9; END_FOR", "n", 4),
    ("WHILE n < 5 DO n := n + 2; END_WHILE", "n", 6),
    ("REPEAT n := n + 2; UNTIL n > 3 END_REPEAT", "n", 4),
    ("FOR i := 1 TO 9 DO IF i = 4 THEN EXIT; END_IF n := i; END_FOR", "n", 3),
    # the counter behind a loop, as TwinCAT leaves it
    ("FOR i := 1 TO 4 DO END_FOR", "i", 5),
    ("FOR i := 9 TO 0 BY -3 DO END_FOR", "i", -3),
    ("FOR i := 3 TO 2 DO END_FOR", "i", 3),
    ("FOR i := 1 TO 9 DO IF i = 4 THEN EXIT; END_IF END_FOR", "i", 4),
    ("FOR us := 250 TO 255 DO END_FOR", "us", 0),
    ("FOR i := 0 TO 1000000 DO IF i = 7 THEN EXIT; END_IF END_FOR", "i", 7),
    ("FOR i := 1 TO 3000 DO FOR j := 1 TO 1000 DO n := n + 1; END_FOR END_FOR", "n", 3_000_000),
    ("FOR i := 1 TO 5 DO IF i = 3 THEN CONTINUE; END_IF n := n + i; END_FOR", "n", 12),
    ("WHILE TRUE DO n := n + 1; IF n = 3 THEN EXIT; END_IF END_WHILE", "n", 3),
    ("FOR i := 1 TO 3 DO FOR j := 1 TO 3 DO IF j = 2 THEN EXIT; END_IF n := n + 1; END_FOR END_FOR", "n", 3),
    ("n := 1; RETURN; n := 2;", "n", 1),
    ("REPEAT n := n + 1; IF n < 3 THEN CONTINUE; END_IF UNTIL TRUE END_REPEAT", "n", 1),
    # arrays, structures, enumerations, constants
    ("n := a[0] + a[3];", "n", 50),
    ("a[1] := 5; i := 1; n := a[i] + a[i + 1];", "n", 35),
    ("n := TABLE[1, -1];", "n", 4),
    ("FOR i := 0 TO 1 DO FOR j := -1 TO 1 DO n := n * 10 + FLAT[i, j]; END_FOR END_FOR", "n", 123456),
    ("t := TABLE; t[0, 0] := 9; n := t[0, 0] + t[1, 1] + TABLE[0, 0];", "n", 17),
    ("f := p.a;", "f", 1.5),
    ("q.b[2] := -4; p := q; q.b[2] := 0; ix := p.b[2];", "ix", -4),
    ("ix := p.b[3];", "ix", 9),
    ("f := PAIR.a;", "f", 2.5),
    ("e := E_Mode.Done; n := TO_DINT(e);", "n", 6),
    ("e := MODES[0]; n := TO_DINT(e);", "n", 5),
    ("ix := COUNT_N;", "ix", 5),
    ("x := e = E_Mode.Idle;", "x", True),
    ("e := SEL(TRUE, E_Mode.Idle, E_Mode.Done); n := TO_DINT(e);", "n", 6),
    ("es := E_Small.One; us := TO_USINT(es);", "us", 1),
    ("E := E_MODE.BUSY; n := TO_DINT(e);", "n", 5),
    # calls
    ("n := F_Double(21);", "n", 42),
    ("n := F_Double(n_in := F_Double(3));", "n", 12),
    (
        "x := F_Split(n_in := 57, n_quotient => n, n_rest => m, n_calls := i); n := n * 10 + m + i * 100;",
        "n",
        157,
    ),
    ("F_Split(n_in := 60, n_calls := i);", "i", 1),
    ("x := F_Split(n_in := 60, n_calls := i);", "x", True),
    ("p.a := 0.25; f := F_Sum(p);", "f", 16.25),
    ("c(); c(); n := c.n_count;", "n", 2),
    ("c(n_by := 5); c(); n := c.n_count;", "n", 10),
    ("c(n_by := 4, n_count => n);", "n", 4),
    ("c.n_by := 3; c(); n := c.n_count;", "n", 3),
    (
        "FOR i := 1 TO 2 DO cs[i](n_by := i); cs[i](); END_FOR n := cs[1].n_count * 10 + cs[2].n_count;",
        "n",
        24,
    ),
    # an output is a variable of the function: it begins anew, and is handed over at the end
    ("n := 9; m := 7; F_Outputs(n_kept => n, n_unset => m); n := n * 10 + m;", "n", 50),
    ("p.a := 8.0; p.b[2] := 8; a[0] := 70; F_Outputs(pair_out => p, a_out => a); f := p.a;", "f", 1.5),
    ("p.b[2] := 8; F_Outputs(pair_out => p); ix := p.b[2];", "ix", 9),
    ("a[0] := 70; a[3] := 9; F_Outputs(a_out => a); n := a[0] * 10 + a[3];", "n", 20),
    ("GLOBAL_N := 5; n := F_Sees(n_out => GLOBAL_N) * 10 + GLOBAL_N;", "n", 51),
    ("GLOBAL_N := 5; m := F_Sees(n_out => m) * 10 + m;", "m", 51),
    ("a[0] := 1; F_Turn(a_in := a, a_out => a); n := a[0] * 100 + a[3];", "n", 4001),
    ("n := F_Local();", "n", 1000 * 3 + 4001),
    # standard functions
    ("n := ABS(-3);", "n", 3),
    ("f := ABS(-2.5);", "f", 2.5),
    ("n := MIN(3, 2) + MAX(5, 4);", "n", 7),
    ("f := MIN(1.0, f);", "f", 0.0),
    ("n := LIMIT(0, 7, 5) + LIMIT(0, -7, 5) * 10;", "n", 5),
    ("f := LIMIT(-1.0, 3.0, 1.0);", "f", 1.0),
    ("n := SEL(FALSE, 1, 2);", "n", 1),
    ("f := SQRT(2.25);", "f", 1.5),
    ("f := EXP(LN(4.0));", "f", 4.0),
    ("f := LOG(1000.0);", "f", 3.0),
    ("f := SIN(0.5) * SIN(0.5) + COS(0.5) * COS(0.5);", "f", 1.0),
    ("f := TAN(ATAN(0.75));", "f", 0.75),
    ("f := ASIN(1.0) + ACOS(1.0);", "f", 1.5707963267948966),
    ("f := EXPT(2.0, 10.0);", "f", 1024.0),
    ("rr := SQRT(rr + 4.0);", "rr", 2.0),
    ("w := SHL(WORD#1, 15);", "w", 0x8000),
    ("w := SHR(WORD#16#8000, 15);", "w", 1),
    ("w := SHL(WORD#1, 16);", "w", 0),
    ("w := ROL(WORD#16#8001, 1);", "w", 3),
    ("b := ROR(BYTE#1, 9);", "b", 0x80),
    # conversions
    ("f := 2.5; n := LREAL_TO_DINT(f);", "n", 2),
    ("f := 3.5; n := LREAL_TO_DINT(f);", "n", 4),
    ("f := -2.5; n := LREAL_TO_DINT(f);", "n", -2),
    ("f := DINT_TO_LREAL(-3);", "f", -3.0),
    ("u := 40000; n := UINT_TO_DINT(u);", "n", 40000),
    ("n := -1; li := DINT_TO_LINT(n);", "li", -1),
    ("w := 16#FFFF; u := WORD_TO_UINT(w);", "u", 65535),
    ("n := BOOL_TO_DINT(TRUE);", "n", 1),
    ("n := 2; x := DINT_TO_BOOL(n);", "x", True),
    ("rr := 0.5; f := REAL_TO_LREAL(rr);", "f", 0.5),
    ("f := 0.5; rr := LREAL_TO_REAL(f);", "rr", 0.5),
    ("n := 200; us := DINT_TO_USINT(n);", "us", 200),
    ("n := TO_DINT(u);", "n", 0),
    ("ul := TO_ULINT(7.0);", "ul", 7),
    ("n := -128; si := DINT_TO_SINT(n);", "si", -128),
    # text
    ("(* a comment\n over lines *) n := 1; // and one to the end\n", "n", 1),
    ("M := 1;", "m", 1),
    (";; n := 4;;", "n", 4),
]


@pytest.fixture(scope="module")
def compiled() -> CompiledProgram:
    """All cases in one program, each a program of its own: compiled once."""
    bodies = [
        f"PROGRAM PRG_{k} VAR {VARIABLES} END_VAR\n{body}\nEND_PROGRAM\n"
        for k, (body, _, _) in enumerate(CASES)
    ]
    return CompiledProgram({"cases.st": TYPES + "".join(bodies)})


@pytest.mark.parametrize("number", range(len(CASES)), ids=[body for body, _, _ in CASES])
def test_the_construct_does_what_the_standard_says(compiled: CompiledProgram, number: int) -> None:
    _, name, expected = CASES[number]
    compiled.run(f"PRG_{number}")
    found = getattr(getattr(compiled.memory, f"PRG_{number}"), name)
    assert found == pytest.approx(expected, rel=1e-15) if isinstance(expected, float) else found == expected


def test_an_instance_keeps_its_variables_and_a_function_does_not() -> None:
    text = """
FUNCTION F_Counted : DINT
VAR
    n : DINT := 3;
    a : ARRAY[0..1] OF DINT := [4, 5];
END_VAR
n := n + a[0];
a[0] := 100;
F_Counted := n;
END_FUNCTION
PROGRAM PRG_Kept
VAR
    n_own, n_function : DINT;
END_VAR
n_own := n_own + 1;
n_function := F_Counted();
END_PROGRAM
"""
    compiled = CompiledProgram({"stored.st": text})
    for _ in range(3):
        compiled.run("PRG_Kept")
    assert compiled.memory.PRG_Kept.as_dict() == {"n_own": 3, "n_function": 7}
    compiled.memory.clear()
    assert compiled.memory.PRG_Kept.n_own == 0
