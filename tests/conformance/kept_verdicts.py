"""Verdicts on broken controllers kept in a file, so that a long run can go on, be shared, and begin well.

A verdict counts again for the very same code alone. Of other code it is a hint: the case that caught a
controller then is asked first.
"""

import hashlib
import json
from pathlib import Path

from tests.support.paths import ROOT

_CODE = (
    "conformance",
    "controller",
    "protocol",
    "nominal_arm",
    "tests/conformance",
    "tests/controller",
    "configs",
)


def code_digest() -> str:
    """A digest of everything that a verdict rests on."""
    digest = hashlib.sha256()
    for folder in _CODE:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".yaml"):
                digest.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


class KeptVerdicts:
    """The rows of a file of JSON lines; several runs may write to one file at a time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._digest = code_digest()
        self._here: dict[tuple[str, str], tuple[int, ...]] = {}
        self._hints: dict[tuple[str, str], int] = {}
        for line in path.read_text().splitlines() if path.exists() else ():
            row = json.loads(line)
            key = row["clause"], row["name"]
            if row["caught_by"]:
                self._hints[key] = row["caught_by"][0]
            if row["code"] == self._digest:
                self._here[key] = tuple(row["caught_by"])

    def of(self, clause: str, name: str) -> tuple[int, ...] | None:
        """The cases that caught a controller of the same code, or None when it was not asked yet."""
        return self._here.get((clause, name))

    def hint(self, clause: str, name: str) -> int:
        """The case that caught it last, or 0."""
        return self._hints.get((clause, name), 0)

    def keep(self, clause: str, name: str, caught_by: tuple[int, ...]) -> None:
        """Write a row."""
        row = {"code": self._digest, "clause": clause, "name": name, "caught_by": caught_by}
        with self._path.open("a") as file:
            file.write(json.dumps(row, ensure_ascii=False) + "\n")
