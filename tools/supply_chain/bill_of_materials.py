"""``python -m tools.supply_chain.bill_of_materials LOCK DOCUMENT``: whether DOCUMENT has all of the lock."""

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tools.supply_chain.requirements_lock import Pin, read_lock


def differences(pins: Iterable[Pin], document: dict[str, Any]) -> list[str]:
    """What the document lacks, or has beside what is locked; empty when it is complete."""
    wanted = {(pin.name, pin.version): pin.hashes for pin in pins}
    found = {(part["name"].lower(), part["version"]): _hashes(part) for part in document["components"]}
    return [
        *(f"{name} {version}: not in the document" for name, version in wanted.keys() - found.keys()),
        *(f"{name} {version}: not in the lock" for name, version in found.keys() - wanted.keys()),
        *(
            f"{pin[0]} {pin[1]}: {len(wanted[pin] ^ found[pin])} hashes differ"
            for pin in wanted.keys() & found.keys()
            if wanted[pin] != found[pin]
        ),
    ]


def _hashes(component: dict[str, Any]) -> frozenset[str]:
    return frozenset(
        each["content"]
        for reference in component.get("externalReferences", ())
        for each in reference.get("hashes", ())
        if each["alg"] == "SHA-256"
    )


def main(lock: str, document: str) -> int:
    """Exit status: 0 when the document is complete."""
    pins = read_lock(Path(lock))
    faults = differences(pins, json.loads(Path(document).read_text(encoding="utf-8")))
    print(*faults, sep="\n", end="\n" if faults else "")
    hashes = sum(len(pin.hashes) for pin in pins)
    print(f"{document}: {len(pins)} packages of {lock} with {hashes} hashes; {len(faults)} differences")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
