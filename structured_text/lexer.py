"""Text to tokens, and the words that no name may be."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from structured_text.errors import Place

NUMBER, NAME, SIGN, END = "number", "name", "sign", "end"

_TOKEN = re.compile(
    r"(?P<space>\s+|//[^\n]*|\(\*.*?\*\))"
    r"|(?P<number>(?:[A-Za-z]+\#[+-]?)?(?:(?:2|8|16)\#[0-9A-Fa-f_]+|\d[\d_]*\.\d[\d_]*(?:[eE][+-]?\d+)?|\d[\d_]*(?!\w)))"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>:=|=>|<=|>=|<>|\.\.|\((?!\*)|[-+*/=<>)\[\]:;,.])",
    re.DOTALL,
)

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
# Functions of the standard and of both systems; no name may hide one.
LIBRARY = frozenset(
    [
        "ABS",
        "ACOS",
        "ASIN",
        "ATAN",
        "ATAN2",
        "COS",
        "EXP",
        "EXPT",
        "LIMIT",
        "LN",
        "LOG",
        "MAX",
        "MIN",
        "MUX",
        "ROL",
        "ROR",
        "SEL",
        "SHL",
        "SHR",
        "SIN",
        "SQRT",
        "TAN",
        "TRUNC",
        "TRUNC_INT",
        "CONCAT",
        "DELETE",
        "FIND",
        "INSERT",
        "LEFT",
        "LEN",
        "MID",
        "REPLACE",
        "RIGHT",
        "CEIL",
        "FLOOR",
        "CTD",
        "CTU",
        "CTUD",
        "F_TRIG",
        "R_TRIG",
        "RS",
        "RTC",
        "SR",
        "TOF",
        "TON",
        "TP",
    ]
)


class Token(NamedTuple):
    """
    ``kind`` is NUMBER, NAME, SIGN or END; ``word`` the text in capitals, as the language ignores case.
    """

    kind: str
    text: str
    word: str
    line: int


def tokens(file: str, text: str) -> Iterator[Token]:
    """The tokens of ``text``, the last one END. Raises StructuredTextError."""
    at, line = 0, 1
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            began = "a comment without its end" if text.startswith("(*", at) else repr(text[at])
            Place(file, line).refuse("syntax", f"{began} is not of the language")
        found = match[0]
        if match.lastgroup != "space":
            yield Token(str(match.lastgroup), found, found.upper(), line)
        line += found.count("\n")
        at = match.end()
    yield Token(END, "the end of the text", "", line)
