"""What a lock file of pip pins: names, versions and hashes."""

import re
from pathlib import Path
from typing import NamedTuple

_PIN = re.compile(r"^([A-Za-z0-9][A-Za-z0-9._-]*)==([^\s;\\]+)")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")


class Pin(NamedTuple):
    """One requirement; ``hashes`` (SHA-256) of the files that it may come in."""

    name: str
    version: str
    hashes: frozenset[str]


def read_lock(path: Path) -> list[Pin]:
    """The requirements of a lock file. Raises ValueError for a line that is neither pinned nor a comment."""
    lines = path.read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    pins = []
    for line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        pin, hashes = _PIN.match(line), frozenset(_HASH.findall(line))
        if pin is None or not hashes:
            raise ValueError(f"{path}: neither version nor hash: {line.split()[0]}")
        pins.append(Pin(pin[1].lower().replace("_", "-"), pin[2], hashes))
    return pins
