"""Text to tokens, and the words that no name may be."""

import re
from collections.abc import Iterator
from typing import NamedTuple

NUMBER, NAME, SIGN, WRONG, END = "number", "name", "sign", "wrong", "end"
_LONGEST = 255

_COMMENTS = re.compile(r"\(\*|\*\)")  # begin and end, also within each other
# Letters and digits are those of ASCII, as in TwinCAT. A pragma that says how parts lie, or what is compiled,
# is none of the harmless ones.
_TOKEN = re.compile(
    r"(?P<space>[\s\ufeff]+|//[^\n]*|/\*.*?\*/"
    r"|\{\s*(?i:attribute\s+'(?!pack_mode)|region|endregion|warning|info|text)[^{}]*\})"
    r"|(?P<name>[A-Za-z_]\w*+(?:(?!\#)|(?=\#[A-Za-z_])))"
    r"|(?P<open>\(\*)"
    r"|(?P<time>(?i:L?TIME|L?T|L?DATE|L?D|L?TOD|L?DT|TIME_OF_DAY|DATE_AND_TIME)\#[\w.:+-]*)"
    r"|(?P<number>(?:[A-Za-z]+\#[+-]?)?(?:(?:2|8|16)\#[0-9A-Fa-f][0-9A-Fa-f_]*|\d[\d_]*\.\d[\d_]*(?:[eE][+-]?\d+)?|\d[\d_]*(?!\w)))"
    r"|(?P<sign>:=|=>|<=|>=|<>|\.\.|\*\*|[-+*/=<>()\[\]:;,.#&])"
    r"|(?P<text>'[^'\n]*'|\"[^\"\n]*\")"
    r"|(?P<foreign>[^\x00-\x7f]+)"
    r"|(?P<wrong>%[\w.*]+|\{[^{}]*\}|\w+|.)",
    re.DOTALL | re.ASCII,
)
_TIMES = "no times: count scans, or nanoseconds in a ULINT"
_WHY = {"time": f": {_TIMES}", "text": ": no strings", "foreign": ": letters and digits are those of ASCII"}

_STANDARD = """
ABSTRACT ACTION AND ANY ANY_BIT ANY_INT ANY_NUM ANY_REAL ARRAY ASSERT AT BOOL BY BYTE CASE CHAR CLASS
CONFIGURATION CONSTANT CONTINUE DATE DATE_AND_TIME DINT DO DT DWORD ELSE ELSIF EN ENO END_ACTION END_CASE
END_CLASS END_CONFIGURATION END_FOR END_FUNCTION END_FUNCTION_BLOCK END_IF END_INTERFACE END_METHOD
END_NAMESPACE END_PROGRAM END_REPEAT END_RESOURCE END_STEP END_STRUCT END_TRANSITION END_TYPE END_VAR
END_WHILE EXIT EXTENDS FALSE F_EDGE FINAL FOR FROM FUNCTION FUNCTION_BLOCK IF IMPLEMENTS INITIAL_STEP INT
INTERFACE INTERNAL LDATE LDT LINT LREAL LTIME LTOD LWORD METHOD MOD NAMESPACE NON_RETAIN NOT NULL OF ON OR
OVERLAP OVERRIDE PRIORITY PRIVATE PROGRAM PROTECTED PUBLIC READ_ONLY READ_WRITE REAL REF REF_TO REPEAT
RESOURCE RETAIN RETURN R_EDGE SINGLE SINT STEP STRING STRUCT SUPER TASK THEN THIS TIME TIME_OF_DAY TO TOD
TRANSITION TRUE TYPE UDINT UINT ULINT UNTIL USING USINT VAR VAR_ACCESS VAR_CONFIG VAR_EXTERNAL VAR_GLOBAL
VAR_INPUT VAR_IN_OUT VAR_OUTPUT VAR_TEMP WCHAR WHILE WITH WORD WSTRING XOR
"""
_TWINCAT_AND_CODESYS = """
ADD ADR ADRINST AND_THEN BIT BITADR CAL CALC CALCN DIV END_GET END_PROPERTY END_SET END_UNION EQ GE GT
INDEXOF INI JMP JMPC JMPCN LD LDN LE LOWER_BOUND LT MOVE MUL NE OR_ELSE ORN ANDN XORN PARAMS PERSISTENT
POINTER PROPERTY R REFERENCE RET RETC RETCN S SIZEOF ST STN SUB TEST_AND_SET UNION UPPER_BOUND UXINT
VAR_GENERIC VAR_INST VAR_STAT XINT XSIZEOF XWORD __CATCH __DELETE __ENDTRY __FINALLY __ISVALIDREF __NEW
__QUERYINTERFACE __QUERYPOINTER __TRY __UXINT __VARINFO __XINT __XWORD
"""
RESERVED = frozenset(_STANDARD.split()) | frozenset(_TWINCAT_AND_CODESYS.split())
# Functions and timers of the standard and of both systems; no name may hide one.
_FUNCTIONS = """
ABS ACOS ASIN ATAN ATAN2 COS EXP EXPT LIMIT LN LOG MAX MIN MUX ROL ROR SEL SHL SHR SIN SQRT TAN TRUNC
TRUNC_INT CONCAT DELETE FIND INSERT LEFT LEN MID REPLACE RIGHT CEIL FLOOR RTC TOF TON TP
"""
LIBRARY = frozenset(_FUNCTIONS.split())
# What the language of others has and this one leaves out, with what to do instead.
LEFT_OUT = {
    word: why
    for words, why in (
        ("STRING WSTRING CHAR WCHAR", "no strings"),
        ("TIME LTIME DATE LDATE TOD LTOD DT LDT TIME_OF_DAY DATE_AND_TIME TON TOF TP RTC", _TIMES),
        ("POINTER REFERENCE REF_TO ADR REF", "no pointers: hand over by VAR_IN_OUT"),
        ("METHOD PROPERTY INTERFACE EXTENDS IMPLEMENTS ACTION CLASS THIS SUPER", "no methods: use FUNCTION"),
        ("AT", "no addresses: use a global variable"),
        ("RETAIN PERSISTENT NON_RETAIN", "nothing outlives the process"),
        ("VAR_EXTERNAL", "global variables are seen without it"),
        ("VAR_STAT VAR_INST", "use VAR of a FUNCTION_BLOCK"),
        ("CONFIGURATION RESOURCE TASK NAMESPACE", "a text has types, variables and units alone"),
        ("UNION", "no unions: convert"),
        ("JMP", "no jumps: use EXIT, CONTINUE or RETURN"),
        ("R_EDGE F_EDGE", "remember the value of the last call"),
        ("**", "use EXPT"),
        ("R_TRIG F_TRIG RS SR CTU CTD CTUD", "declare that FUNCTION_BLOCK"),
        ("#", "only a type or an enumeration stands before it"),
    )
    for word in words.split()
}


def why_left_out(word: str) -> str:
    """What is said of a ``word`` that is left out; nothing of others."""
    return f": {LEFT_OUT[word]}" if word in LEFT_OUT else ""


class Token(NamedTuple):
    """``kind`` is NUMBER, NAME, SIGN, WRONG or END; ``word`` the text in capitals: the language ignores case.

    The ``text`` of a WRONG one says why it is none of the language.
    """

    kind: str
    text: str
    word: str
    line: int


def _comment_end(text: str, begin: int) -> int | None:
    """Where the comment from ``begin`` on ends, with those within it; None: nowhere."""
    depth = 0
    for mark in _COMMENTS.finditer(text, begin):
        depth += 1 if mark[0] == "(*" else -1
        if depth == 0:
            return mark.end()
    return None


def tokens(text: str) -> Iterator[Token]:
    """The tokens of ``text``, the last one END."""
    at, line = 0, 1
    while match := _TOKEN.match(text, at):
        kind, found, at = str(match.lastgroup), match[0], match.end()
        if kind == "open":
            end = _comment_end(text, match.start())
            kind, at = ("open", len(text)) if end is None else ("space", end)
            found = text[match.start() : at]
        if kind in (NUMBER, NAME, SIGN) and len(found) <= _LONGEST:
            yield Token(kind, found, "AND" if found == "&" else found.upper(), line)
        else:
            if kind != "space":
                message = (
                    f"{found[:20]}… has {len(found)} characters: at most {_LONGEST}" if kind in (NUMBER, NAME)
                    else "a comment without its end is not of the language" if kind == "open"
                    else f"{found[:_LONGEST]!r} is not of the language{_WHY.get(kind, '')}"
                )  # fmt: skip
                yield Token(WRONG, message, "?", line)
            line += found.count("\n")
    yield Token(END, "the end of the text", "", line)
