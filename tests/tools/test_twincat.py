"""The files for TwinCAT and PLCopen XML: nothing is lost on the way, and another parser reads them."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from structured_text.checker import check
from structured_text.parser import Parser
from tests.support.paths import ROOT
from tools.plcopen import KINDS, plcopen_xml, shipped
from tools.twincat import PlcObject, objects, write

LARGE = 3000  # bytes: a larger file takes that parser seconds, the constants four minutes; read once by hand
ENDS = {"FUNCTION_BLOCK": "END_FUNCTION_BLOCK", "FUNCTION": "END_FUNCTION", "PROGRAM": "END_PROGRAM"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[PlcObject]]:
    directory = tmp_path_factory.mktemp("twincat")
    return directory, write(directory)


def text_of(file: Path) -> str:
    """What a file declares and does, as one text again."""
    root = ET.parse(file).getroot()
    declared, done = root.findtext(".//Declaration") or "", root.findtext(".//ST")
    if done is None:
        return declared
    begins = next(word for line in declared.splitlines() for word in ENDS if line.startswith(f"{word} "))
    return f"{declared}{done}{ENDS[begins]}\n"


def test_all_files_together_are_the_whole_program(written: tuple[Path, list[PlcObject]]) -> None:
    directory, made = written
    files = sorted(directory.rglob("*.Tc*"))
    assert len({each.file for each in made}) == len(made) == len(files) > 200
    # What stands around the program calls TwinCAT's own libraries: blark alone reads that.
    around = {each.name for each in objects("adapters", (ROOT / "plc/twincat/adapters.st").read_text())}
    own = [file for file in files if file.stem not in around]
    assert len(files) - len(own) == len(around) > 5
    parsed = [each for file in own for each in Parser(file.name, text_of(file)).declarations()]
    names = check(parsed)
    assert "PRG_LR_CONTROLLER" in names.units
    project = (directory / "Longreach.plcproj").read_text(encoding="utf-8")
    assert all(each.file.replace("/", "\\") in project for each in made)


def test_a_changed_text_keeps_its_identifiers() -> None:
    text = "(* why *)\nFUNCTION F_One : INT\nVAR\n    i : INT;\nEND_VAR\nF_One := %d;\nEND_FUNCTION\n"
    (before,), (after,) = (list(objects("one", text % number)) for number in (1, 2))
    assert before.xml != after.xml
    assert before.xml.replace("F_One := 1", "F_One := 2") == after.xml
    assert before.declaration.startswith("(* why *)\nFUNCTION F_One")


@pytest.mark.timeout(900)
@pytest.mark.slow("another parser reads two hundred files")
def test_blark_reads_every_file_but_the_large_ones(written: tuple[Path, list[PlcObject]]) -> None:
    blark = pytest.importorskip("blark.parse", reason="blark is absent: make peers")
    files = [file for file in written[0].rglob("*.Tc*") if file.stat().st_size < LARGE]
    assert len(files) > 200
    for file in sorted(files):
        found = list(blark.parse(file))
        assert found, file.name
        assert [each.exception for each in found if each.exception is not None] == [], file.name


NAMES = {"p": "http://www.plcopen.org/xml/tc6_0201", "x": "http://www.w3.org/1999/xhtml"}
SECTIONS = {
    "inputVars": "VAR_INPUT",
    "outputVars": "VAR_OUTPUT",
    "inOutVars": "VAR_IN_OUT",
    "localVars": "VAR",
}


def tag(element: ET.Element) -> str:
    return element.tag.partition("}")[2]


def type_text(of: ET.Element) -> str:
    (inner,) = of
    if tag(inner) == "array":
        bounds = ", ".join(f"{d.get('lower')}..{d.get('upper')}" for d in inner.findall("p:dimension", NAMES))
        base = inner.find("p:baseType", NAMES)
        assert base is not None
        return f"ARRAY[{bounds}] OF {type_text(base)}"
    return inner.get("name") or tag(inner)


def value_text(of: ET.Element) -> str:
    (inner,) = of
    if tag(inner) == "arrayValue":
        return f"[{', '.join(map(value_text, inner))}]"
    if tag(inner) == "structValue":
        parts = (f"{each.get('member')} := {value_text(each)}" for each in inner)
        return f"({', '.join(parts)})"
    return inner.get("value") or ""


def variables(of: ET.Element) -> str:
    lines = []
    for variable in of:
        kind, initial = variable.find("p:type", NAMES), variable.find("p:initialValue", NAMES)
        assert kind is not None
        begins = "" if initial is None else f" := {value_text(initial)}"
        lines.append(f"{variable.get('name')} : {type_text(kind)}{begins};")
    return "\n".join(lines)


def data_type(of: ET.Element) -> str:
    base = of[0]
    if tag(base[0]) == "struct":
        return f"TYPE\n{of.get('name')} : STRUCT\n{variables(base[0])}\nEND_STRUCT\nEND_TYPE\n"
    if tag(base[0]) == "enum":
        values = ", ".join(f"{v.get('name')} := {v.get('value')}" for v in base[0][0])
        return f"TYPE\n{of.get('name')} : ({values}) {tag(base[0][1][0])};\nEND_TYPE\n"
    return f"TYPE\n{of.get('name')} : {type_text(base)};\nEND_TYPE\n"


def unit(pou: ET.Element) -> str:
    kind = {v: k for k, v in KINDS.items()}[pou.get("pouType")]
    interface, body = pou[0], pou.findtext("p:body/p:ST/x:p", "", NAMES)
    returned = interface.find("p:returnType", NAMES)
    head = f"{kind} {pou.get('name')}" + ("" if returned is None else f" : {type_text(returned)}")
    lists = [f"{SECTIONS[tag(e)]}\n{variables(e)}\nEND_VAR" for e in interface if tag(e) in SECTIONS]
    return "\n".join([head, *lists, f"{body}END_{kind}\n"])


def test_plcopen_xml_holds_the_whole_program() -> None:
    """Every part of the file as text again: the compiler knows the same types, variables and units."""
    root = ET.fromstring(plcopen_xml(shipped()))
    texts = [data_type(each) for each in root.iterfind("p:types/p:dataTypes/p:dataType", NAMES)]
    for each in root.iterfind(".//p:globalVars", NAMES):
        constant = " CONSTANT" if each.get("constant") else ""
        texts.append(f"VAR_GLOBAL{constant}\n{variables(each)}\nEND_VAR\n")
    texts += [unit(each) for each in root.iterfind("p:types/p:pous/p:pou", NAMES)]
    again = check([d for text in texts for d in Parser("again.st", text).declarations()])
    own = check([d for stem, text in shipped() for d in Parser(f"{stem}.st", text).declarations()])
    assert again.units.keys() == own.units.keys()
    for name, mine in own.units.items():
        theirs = again.units[name].variables
        assert [(v.name, v.section, str(v.type)) for v in theirs.values()] == [
            (v.name, v.section, str(v.type)) for v in mine.variables.values()
        ]
    assert plcopen_xml(shipped()) == plcopen_xml(shipped())
