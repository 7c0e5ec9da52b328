"""The controller in structured text as files of TwinCAT 3: `python -m tools.twincat DIRECTORY`.

One .TcPOU a function or program, one .TcDUT a type, one .TcGVL a text's variables, and Longreach.plcproj of
them all. Identifiers are made from names, so that a new generation differs only where the texts do. Sockets,
fieldbus and clock stay with whoever calls PRG_LR_Controller: docs/structured_text.md.
"""

import re
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from tools.tables import ROOT

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "urn:longreach:plc")
_BEGINS = re.compile(r"^(FUNCTION_BLOCK|FUNCTION|PROGRAM|TYPE|VAR_GLOBAL)\b[ \t]*(\w*)", re.MULTILINE)
_TYPE_NAME = re.compile(r"^(\w+)\s*:", re.MULTILINE)
_LAST_VAR = re.compile(r"^END_VAR[^\n]*\n", re.MULTILINE)


class PlcObject(NamedTuple):
    """A file: ``kind`` is POU, DUT or GVL; ``body``: None where the kind has none."""

    kind: str
    name: str
    declaration: str
    body: str | None

    @property
    def file(self) -> str:
        """Its place in the project."""
        folder = {"POU": "POUs", "DUT": "DUTs", "GVL": "GVLs"}[self.kind]
        return f"{folder}/{self.name}.Tc{self.kind}"

    @property
    def xml(self) -> str:
        """The file's text."""
        name, number = quoteattr(self.name), uuid.uuid5(_NAMESPACE, f"{self.kind}:{self.name}")
        special = ' SpecialFunc="None"' if self.kind == "POU" else ""
        body = (
            "" if self.body is None else f"\n    <Implementation><ST>{_data(self.body)}</ST></Implementation>"
        )
        return (
            '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1">\n'
            f'  <{self.kind} Name={name} Id="{{{number}}}"{special}>\n'
            f"    <Declaration>{_data(self.declaration)}</Declaration>{body}\n"
            f"  </{self.kind}>\n</TcPlcObject>\n"
        )


def objects(stem: str, text: str) -> Iterator[PlcObject]:
    """The parts of a text, each with the comment in front of it."""
    last = 0
    for begin in _BEGINS.finditer(text):
        if begin.start() < last:
            continue
        kind, name = begin.groups()
        ends = "END_VAR" if kind == "VAR_GLOBAL" else f"END_{kind}"
        end = text.index(f"\n{ends}", begin.start()) + 1 + len(ends)
        comment, last = text[last : begin.start()].strip(), end
        part = text[begin.start() : end] + "\n"
        lead = f"{comment}\n" if comment else ""
        if kind == "TYPE":
            yield from _types(part)
        elif kind == "VAR_GLOBAL":
            constant = "Constants" if part.startswith("VAR_GLOBAL CONSTANT") else "Variables"
            yield PlcObject("GVL", f"GVL_LR_{stem.title()}{constant}", lead + part, None)
        else:
            inside = part[: part.rindex(ends)]
            cut = max((found.end() for found in _LAST_VAR.finditer(inside)), default=inside.index("\n") + 1)
            yield PlcObject("POU", name, lead + inside[:cut], inside[cut:])


def _types(part: str) -> Iterator[PlcObject]:
    inside = part[part.index("\n") + 1 : part.rindex("END_TYPE")]
    names = list(_TYPE_NAME.finditer(inside))
    for found, after in zip(names, [*(each.start() for each in names[1:]), len(inside)], strict=True):
        yield PlcObject("DUT", found[1], f"TYPE {inside[found.start() : after].rstrip()}\nEND_TYPE\n", None)


def project(made: list[PlcObject]) -> str:
    """Longreach.plcproj: every file, in order."""
    files = sorted(each.file.replace("/", "\\") for each in made)
    lines = "\n".join(f'    <Compile Include="{file}"><SubType>Code</SubType></Compile>' for file in files)
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<Project DefaultTargets="Build" xmlns="http://schemas.microsoft.com/developer/msbuild/2003">\n'
        f"  <PropertyGroup>\n    <Name>Longreach</Name>\n    <ProjectGuid>{{{_NAMESPACE}}}</ProjectGuid>\n"
        f"  </PropertyGroup>\n  <ItemGroup>\n{lines}\n  </ItemGroup>\n</Project>\n"
    )


def write(directory: Path) -> list[PlcObject]:
    """Write all files of the shipped texts below ``directory``; what was written. Raises OSError."""
    made = [each for path in _texts() for each in objects(path.stem, path.read_text())]
    for each in made:
        place = directory / each.file
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(each.xml, encoding="utf-8")
    (directory / "Longreach.plcproj").write_text(project(made), encoding="utf-8")
    return made


def _texts() -> list[Path]:
    folders = [ROOT / folder for folder in ("docs/protocol", "plc", "plc/twincat")]
    return [path for folder in folders for path in sorted(folder.glob("*.st"))]


def _data(text: str) -> str:
    return f"<![CDATA[{text}]]>"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("which directory? python -m tools.twincat DIRECTORY")
    print(f"{len(write(Path(sys.argv[1])))} files and Longreach.plcproj in {sys.argv[1]}")
