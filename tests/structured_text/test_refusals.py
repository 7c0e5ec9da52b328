"""Wrong programs: each is refused with one line that says where and why."""

import pytest

from structured_text.errors import StructuredTextError
from structured_text.program import CompiledProgram

HEAD = """TYPE
E_Mode : (Idle, Busy);
ST_Pair : STRUCT
a : LREAL;
b : INT;
END_STRUCT
END_TYPE
VAR_GLOBAL CONSTANT
LIMIT_N : INT := 3;
END_VAR
FUNCTION F_One : INT
VAR_INPUT
n_in : INT;
END_VAR
VAR_OUTPUT
n_out : INT;
END_VAR
F_One := n_in;
END_FUNCTION
FUNCTION_BLOCK FB_One
VAR_INPUT
n_in : INT;
END_VAR
VAR_OUTPUT
n_out : INT;
END_VAR
VAR
n_own : INT;
END_VAR
n_out := n_in;
END_FUNCTION_BLOCK
PROGRAM PRG
VAR
n : INT;  u : UINT;  f : LREAL;  x : BOOL;  w : WORD;  e : E_Mode;  p : ST_Pair;
a : ARRAY[0..3] OF INT;  c : FB_One;
END_VAR
"""
LINE = HEAD.count("\n") + 1

STATEMENTS = [
    ("n := u;", "expected INT, found UINT"),
    ("n := f;", "expected INT, found LREAL"),
    ("n := 40000;", "40000 does not fit INT"),
    ("n := INT#70000;", "70000 does not fit INT"),
    ("n := SINT#-129;", "-129 does not fit SINT"),
    ("w := 16#1FFFF;", "131071 does not fit WORD"),
    ("w := WORD#16#1FFFF;", "131071 does not fit WORD"),
    ("x := BOOL#2;", "2 does not fit BOOL"),
    ("f := 1.0E400;", "1.0E400 does not fit LREAL"),
    ("f := REAL#1.0E39;", "1e+39 does not fit REAL"),
    ("n := ä;", "'ä' is not of the language: letters and digits are those of ASCII"),
    ("n := ٣;", "'٣' is not of the language: letters and digits are those of ASCII"),
    ("u := -1;", "-1 does not fit UINT"),
    ("x := n;", "expected BOOL, found INT"),
    ("n := n + u;", "INT + UINT: expected two of one type"),
    ("w := w + w;", "+ of WORD"),
    ("u := -u;", "- of UINT"),
    ("x := NOT n;", "NOT of INT"),
    ("f := f MOD f;", "MOD of LREAL"),
    ("x := x < x;", "< of BOOL"),
    ("IF n THEN n := 1; END_IF", "expected BOOL, found INT"),
    ("missing := 1;", "missing is not declared"),
    ("n := missing;", "missing is not declared"),
    ("n := F_Missing(1);", "F_Missing is not declared"),
    ("p.c := 1;", "ST_Pair has no c"),
    ("n.a := 1;", "INT has no members"),
    ("n[0] := 1;", "INT has no elements"),
    ("a[4] := 1;", "index 4 is outside 0..3"),
    ("a[0, 1] := 1;", "1 indices are expected, 2 are given"),
    ("a[x] := 1;", "an index of BOOL: expected a whole number"),
    ("LIMIT_N := 4;", "expected a variable"),
    ("n := F_One();", "F_One is called without n_in"),
    ("n := F_One(1, n, n);", "F_One takes 2 arguments"),
    ("n := F_One(n_more := 1);", "F_One has no parameter n_more"),
    ("n := F_One(n_in => n);", "n_in of F_One is given with :="),
    ("n := F_One(n_in := 1, n_in := 2);", "n_in is given twice"),
    ("n := FB_One(1);", "FB_One is called through an instance"),
    ("n := c(n_in := 1);", "the call of FB_One has no value: read its outputs"),
    ("n := c.n_own;", "n_own is private to FB_One"),
    ("c.n_out := 1;", "n_out is an output of its block: it cannot be written"),
    ("e := E_Mode.Gone;", "E_Mode has no Gone"),
    ("e := 1;", "expected E_Mode, found DINT"),
    ("EXIT;", "EXIT stands in no loop"),
    ("FOR f := 1 TO 2 DO END_FOR", "FOR counts with f: expected a whole number of VAR"),
    ("FOR n := 1 TO 3 DO n := 2; END_FOR", "n counts a FOR: it cannot be written within"),
    ("FOR n := 1 TO 3 BY 0 DO END_FOR", "FOR goes on BY 0"),
    ("CASE n OF 1: n := 2; 1..2: n := 3; END_CASE", "the label 1 stands twice in one CASE"),
    ("CASE f OF 1: n := 2; END_CASE", "CASE of LREAL: expected a whole number or an enumeration"),
    ("n := ;", "expected an expression, found ;"),
    ("n = 1;", "expected :=, found ="),
    ("n := 1", "expected ;, found END_PROGRAM"),
    ("IF x THEN n := 1;", "expected ELSIF or ELSE or END_IF, found END_PROGRAM"),
    ("n := 8#19;", "8#19 has digits beyond its base 8"),
    ("n := STUFF#1;", "STUFF is no type of a literal"),
    ("n := 1 $ 2;", "'$' is not of the language"),
    ("(* n := 1;", "a comment without its end is not of the language"),
    ("n := INT_TO_UINT(n);", "expected INT, found UINT"),
    ("u := INT_TO_UINT(u);", "INT_TO_UINT takes INT"),
    ("f := SQRT(n);", "SQRT of INT"),
    ("n := MIN(n, u);", "MIN takes values of one type, found INT, UINT"),
    ("w := SHL(n, 1);", "SHL takes a bit string and a whole number"),
    ("f := SIN(x := f);", "SIN takes its arguments by place"),
    (
        "f := WORD_TO_LREAL(w);",
        "WORD_TO_LREAL: the standard keeps the bits, TwinCAT the value: take a whole number between",
    ),
    ("n := ABS(n, n);", "ABS takes 1 arguments, 2 are given"),
]


def refusal(text: str) -> StructuredTextError:
    with pytest.raises(StructuredTextError) as caught:
        CompiledProgram({"wrong.st": text})
    return caught.value


@pytest.mark.parametrize(("statement", "why"), STATEMENTS, ids=[s for s, _ in STATEMENTS])
def test_a_wrong_statement_is_refused_in_its_line(statement: str, why: str) -> None:
    error = refusal(f"{HEAD}\n{statement} END_PROGRAM")
    assert str(error) == f"wrong.st:{LINE + 1}: {why}"
    assert error.cause.startswith("structured_text.")


DECLARATIONS = [
    ("VAR at : LREAL; END_VAR", "at is a reserved word"),
    ("VAR s : INT; END_VAR", "s is a reserved word"),
    ("VAR Step : INT; END_VAR", "Step is a reserved word"),
    ("VAR ref_to : INT; END_VAR", "ref_to is a reserved word"),
    ("VAR pointer : INT; END_VAR", "pointer is a reserved word"),
    ("VAR __try : INT; END_VAR", "__try is a reserved word"),
    ("VAR __mine : INT; END_VAR", "__mine begins with two underscores"),
    ("VAR limit : INT; END_VAR", "limit is a standard function"),
    ("VAR INT_TO_UINT : INT; END_VAR", "INT_TO_UINT is a standard function"),
    ("VAR ca : LREAL; END_VAR", "ca hides a global name (the language ignores case)"),
    ("VAR st_x : INT; END_VAR", "st_x hides a global name (the language ignores case)"),
    ("VAR n : INT; N : INT; END_VAR", "N is declared twice (the language ignores case)"),
    ("VAR n : T_Missing; END_VAR", "T_Missing is no type"),
    ("VAR n : ARRAY[3..1] OF INT; END_VAR", "bounds 3..1 hold nothing"),
    ("VAR a : ARRAY[0..2] OF INT := [1, 2]; END_VAR", "3 elements are expected, 2 are given"),
    ("VAR n : INT := 40000; END_VAR", "40000 does not fit INT"),
    ("VAR n : INT := 1.5; END_VAR", "expected INT, found LREAL"),
    ("VAR CONSTANT n : INT; END_VAR", "the constant n has no value"),
    ("VAR n : INT := n_other; END_VAR", "n_other is not declared"),
    (
        "VAR n : ARRAY[0..99999999] OF LREAL; END_VAR",
        "ARRAY[0..99999999] OF LREAL has 800000000 bytes: at most 67108864",
    ),
    ("VAR n : INT := 1 / 0; END_VAR", "division by zero"),
    ("VAR n INT; END_VAR", "expected :, found INT"),
    ("VAR 1n : INT; END_VAR", "'1n' is not of the language"),
]
GLOBALS = "VAR_GLOBAL CONSTANT cA : LREAL := 1.0; END_VAR TYPE ST_X : STRUCT a : INT; END_STRUCT END_TYPE"


@pytest.mark.parametrize(("section", "why"), DECLARATIONS, ids=[s for s, _ in DECLARATIONS])
def test_a_wrong_declaration_is_refused_in_its_line(section: str, why: str) -> None:
    assert str(refusal(f"{GLOBALS}\nPROGRAM PRG\n{section}\nEND_PROGRAM")) == f"wrong.st:3: {why}"


UNITS = [
    ("TYPE ST_A : STRUCT a : ST_A; END_STRUCT END_TYPE", "ST_A contains itself"),
    ("TYPE E : (A, A); END_TYPE", "A is declared twice (the language ignores case)"),
    ("TYPE E : (A) LREAL; END_TYPE", "LREAL is no base of an enumeration"),
    ("TYPE A : INT; END_TYPE TYPE a : INT; END_TYPE", "a is declared twice (the language ignores case)"),
    ("FUNCTION F : DINT F := F(); END_FUNCTION", "F calls itself"),
    (
        "FUNCTION F : T_A END_FUNCTION TYPE T_A : ARRAY[0..1] OF INT; END_TYPE",
        "F returns ARRAY[0..1] OF INT: use VAR_OUTPUT",
    ),
    (
        "FUNCTION F : DINT VAR_INPUT n : INT; END_VAR n := 1; END_FUNCTION",
        "n is an input: it cannot be written",
    ),
    ("x := 1;", "expected TYPE, VAR_GLOBAL, FUNCTION, FUNCTION_BLOCK or PROGRAM, found x"),
    (
        "FUNCTION_BLOCK FB END_FUNCTION_BLOCK FUNCTION F : INT VAR c : FB; END_VAR END_FUNCTION",
        "c: a function keeps no function block",
    ),
    (
        "FUNCTION F : INT VAR_IN_OUT n : INT := 1; END_VAR END_FUNCTION",
        "n is the caller's: it has no initial value",
    ),
    (
        "FUNCTION F : INT VAR_IN_OUT n : INT; END_VAR END_FUNCTION "
        "PROGRAM PRG VAR u : UINT; END_VAR F(n := u); END_PROGRAM",
        "expected INT, found UINT",
    ),
    ("FUNCTION A : INT A := B(); END_FUNCTION FUNCTION B : INT B := A(); END_FUNCTION", "A calls itself"),
]


@pytest.mark.parametrize(("text", "why"), UNITS, ids=[t for t, _ in UNITS])
def test_a_wrong_unit_is_refused_in_its_line(text: str, why: str) -> None:
    assert str(refusal(f"\n{text}")) == f"wrong.st:2: {why}"


def test_all_errors_are_told_at_once_in_their_order_and_none_that_follows_from_another() -> None:
    first = "VAR_GLOBAL\n  a : T_Gone;\n  b : INT := 1.5;\n  c INT;\n  d : INT;\nEND_VAR\n"
    second = """PROGRAM PRG
VAR n : INT; at : INT; x : BOOL; END_VAR
a := 1; b := 1; c := 1; at := 1;
n := ;
n := d + TRUE;
IF n THEN gone := 1; END_IF
WHILE x DO
n = 1;
END_IF
END_WHILE
n := F(missing := 1);
END_PROGRAM
FUNCTION F : INT
VAR_INPUT k : INT; END_VAR
F := k $ 1;
F := other;
END_FUNCTION
FUNCTION G INT
END_FUNCTION
"""
    with pytest.raises(StructuredTextError) as caught:
        CompiledProgram({"first.st": first, "second.st": second})
    assert str(caught.value).splitlines() == [
        "first.st:2: T_Gone is no type",
        "first.st:3: expected INT, found LREAL",
        "first.st:4: expected :, found INT",
        "second.st:2: at is a reserved word",
        "second.st:4: expected an expression, found ;",
        "second.st:5: INT + BOOL: expected two of one type",
        "second.st:6: expected BOOL, found INT",
        "second.st:6: gone is not declared",
        "second.st:8: expected :=, found =",
        "second.st:9: expected an expression, found END_IF",
        "second.st:11: F has no parameter missing",
        "second.st:15: '$' is not of the language",
        "second.st:16: other is not declared",
        "second.st:19: expected :=, found END_FUNCTION",
    ]
