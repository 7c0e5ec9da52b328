"""Texts that no person writes: each is compiled or refused in our own words, within a bound of time."""

import random
import re
import time

import pytest

from structured_text.errors import MOST_ERRORS, ProgramFaulted, StructuredTextError
from structured_text.program import CompiledProgram

SOUND = """TYPE
E_Mode : (Idle, Busy := 5) UINT; T_Row : ARRAY[0..2] OF INT;
ST_Pair : STRUCT a : LREAL := 1.5; b : T_Row := [1, 2(3)]; END_STRUCT
END_TYPE
VAR_GLOBAL CONSTANT cLast : INT := 2; END_VAR
FUNCTION F_Sum : INT VAR_INPUT aRow : T_Row; END_VAR VAR_OUTPUT nMost : INT; END_VAR VAR i : INT; END_VAR
FOR i := 0 TO cLast DO F_Sum := F_Sum + aRow[i]; nMost := MAX(nMost, aRow[i]); END_FOR
END_FUNCTION
FUNCTION_BLOCK FB_Count VAR_INPUT xUp : BOOL; END_VAR VAR_OUTPUT nCount : UDINT; END_VAR
IF xUp AND NOT (nCount > 16#FF) THEN nCount := nCount + 1; ELSIF xUp THEN RETURN; ELSE nCount := 0; END_IF
END_FUNCTION_BLOCK
PROGRAM PRG VAR p : ST_Pair; n : INT; e : E_Mode; c : FB_Count; END_VAR
n := F_Sum(aRow := p.b, nMost => p.b[0]); c(xUp := n = 7);
CASE n OF 1, 3..5: e := E_Mode.Busy; ELSE e := Idle; END_CASE
WHILE n < 9 DO n := n + 1; IF n = 8 THEN EXIT; END_IF END_WHILE
REPEAT p.a := SQRT(p.a) / 2.0; n := n - 1; UNTIL n < 0 END_REPEAT
END_PROGRAM
"""
PIECES = re.findall(r"\w+|:=|=>|\.\.|\S|\s+", SOUND)


def outcome(text: str) -> str:
    """What becomes of ``text``."""
    begin = time.thread_time()
    try:
        CompiledProgram({"hostile.st": text}).run("PRG")
        told = "compiled"
    except StructuredTextError as error:
        told = str(error)
        assert all(re.match(r"hostile\.st:\d+: .{1,600}$", line) for line in told.splitlines()), told
        assert told.count("\n") < MOST_ERRORS
    except (ProgramFaulted, KeyError) as error:  # a run-time check; PRG has another name now
        told = str(error)
    assert time.thread_time() - begin < 5.0, "a text of this size takes 0.1 s"
    return told


@pytest.fixture(autouse=True)
def nothing_is_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("structured_text.program.cache_root", lambda: None)


def mutated(rng: random.Random) -> str:
    """The sound text with a few of its pieces left out, doubled, exchanged or spoilt."""
    pieces = list(PIECES)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(pieces))
        odd = [*"()[];:.#'*", "(*", "END_IF", "VAR", "16#", "é", "1.0E999", "{", "\0", rng.choice(PIECES)]
        pieces[at : at + rng.randint(0, 2)] = [rng.choice(odd)] * rng.randint(0, 2)
    return "".join(pieces)


@pytest.mark.parametrize("seed", range(8))
def test_a_spoilt_text_is_compiled_or_refused(seed: int) -> None:
    rng = random.Random(seed)
    told = [outcome(mutated(rng)) for _ in range(50)]
    assert sum(each != "compiled" for each in told) > 30
    noises = (
        [rng.choice((rng.randrange(128), rng.randrange(0x3000))) for _ in range(400)] for _ in range(20)
    )
    assert all(outcome("".join(map(chr, noise))) != "compiled" for noise in noises)


def chain(of: str, count: int = 3000) -> str:
    """Declarations, each of which needs the next one, or the one before."""
    return "".join(of.format(k, k + 1) for k in range(count))


DOUBLED = "S0 : STRUCT a : INT; END_STRUCT " + chain("S{1} : STRUCT a, b : S{0}; END_STRUCT ", 60)
CALLS = "VAR_GLOBAL g : DINT; END_VAR FUNCTION F0 : DINT g := (g + 1) MOD 9; F0 := g; END_FUNCTION " + chain(
    "FUNCTION F{1} : DINT F{1} := F{0}() MOD 2 + F{0}(); END_FUNCTION ", 60
)
WITHOUT_END = {
    "brackets": ("", f"n := {'(' * 2000}1{')' * 2000};", "more than 50 brackets"),
    "terms": ("", f"n := 1{' + 1' * 20_000};", "more than 150 operators"),
    "members": ("", f"n{'.a' * 20_000} := 1;", "more than 150 operators"),
    "signs": ("", f"n := {'-' * 5000}n;", "more than 50 brackets"),
    "statements": ("", f"{'IF TRUE THEN ' * 2000}{'END_IF ' * 2000}", "more than 50 brackets"),
    "arrays": (f"TYPE T : {'ARRAY[0..0] OF ' * 2000} INT; END_TYPE", "", "more than 50 brackets"),
    "lists": (f"VAR_GLOBAL a : INT := {'[' * 2000}1{']' * 2000}; END_VAR", "", "more than 50 brackets"),
    "digits": ("", f"n := {'1' * 5000};", "has 5000 characters: at most 255"),
    "a name": ("", f"{'n' * 5000} := 1;", "has 5000 characters: at most 255"),
    "comments": ("", "(* " * 5000, "a comment without its end"),
    "structures": ("TYPE " + chain("S{0} : STRUCT a : S{1}; END_STRUCT ") + "END_TYPE", "", "more than 40 d"),
    "constants": (f"VAR_GLOBAL CONSTANT {chain('c{0} : INT := c{1};')} END_VAR", "", "more than 40 d"),
    "itself": ("VAR_GLOBAL CONSTANT a : INT := b; b : INT := a; END_VAR", "", "a contains itself"),
    "doubled": (f"TYPE {DOUBLED} END_TYPE", "", "has 134217728 bytes: at most 67108864"),
    "repeated": ("VAR_GLOBAL a : ARRAY[0..9] OF INT := [99999999(1)]; END_VAR", "", "1 to 65536"),
    "stack": ("FUNCTION F : INT VAR a : ARRAY[0..999999] OF LREAL; END_VAR END_FUNCTION", "", "over 1048576"),
    "errors": ("", chain("gone{0} := 1;\n", 1000), "hostile.st:20: gone19 is not declared"),
    "a long FOR": ("", "FOR k := 1 TO 100000000000 DO n := n MOD 7 + 1; END_FOR", "a loop does not end"),
    "FOR in FOR": ("", "FOR k := 1 TO 9999 DO FOR j := 1 TO 9999 DO n := n MOD 7; END_FOR END_FOR", "a loop"),
    "calls": (CALLS, "n := F60();", "a loop does not end"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WITHOUT_END)
def test_what_has_no_end_is_ended_with_its_reason(kind: str) -> None:
    before, body, why = WITHOUT_END[kind]
    assert why in outcome(f"{before} PROGRAM PRG VAR n : DINT; j, k : LINT; END_VAR {body} END_PROGRAM")
