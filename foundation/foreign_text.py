"""Text files that other programs wrote: their byte order marks, and what a spreadsheet makes of columns."""

import codecs
import json
import re
from pathlib import Path
from typing import Any

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_DECIMAL_COMMA = re.compile(r"(?<![\d,])-?\d+,\d+(?![\d,])")


def decoded(data: bytes) -> str:
    """``data`` as text: UTF-8 with or without a byte order mark, or UTF-16 with one. Raises
    UnicodeDecodeError.
    """
    return data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig")


def read_text(path: Path) -> str:
    """What is in the file, as ``decoded`` has it. Raises OSError, UnicodeDecodeError."""
    return decoded(path.read_bytes())


def parse_json(text: str) -> Any:
    """What JSON ``text`` holds. Raises ValueError, also where it is nested too deeply for the parser."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def other_separators(head: str, row: str) -> str | None:
    """What stands between the columns of ``head`` and in the numbers of ``row`` where commas and decimal
    points are wanted, in words; None where those stand there.
    """
    for sign, name in ((";", "semicolons"), ("\t", "tabs")):
        if head.count(sign) > head.count(","):
            commas = any(_DECIMAL_COMMA.fullmatch(cell.strip().strip('"')) for cell in row.split(sign))
            numbers = ", and decimal commas in numbers" if commas else ""
            form = "commas and decimal points are wanted" if commas else "commas are wanted"
            return f"{name} stand between columns{numbers}: {form} (a spreadsheet saves so as CSV in English)"
    return None
