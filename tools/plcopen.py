"""The controller in structured text as one PLCopen XML file (TC6 2.01), which CODESYS and others import.

`python -m tools.plcopen FILE.xml`. Interfaces are the tree's, bodies the texts' own; nothing in it depends on
when it was made, so that a new generation differs only where the texts do.
"""

import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

from structured_text import syntax as tree
from structured_text.parser import Parser
from tools.protocol_page import ROOT
from tools.twincat import objects

_NAMESPACE = "http://www.plcopen.org/xml/tc6_0201"
_XHTML = "http://www.w3.org/1999/xhtml"
_ELEMENTARY = (
    *("BOOL", "BYTE", "WORD", "DWORD", "LWORD", "SINT", "INT", "DINT", "LINT"),
    *("USINT", "UINT", "UDINT", "ULINT", "REAL", "LREAL"),
)
_LISTS = {
    "VAR_INPUT": "inputVars", "VAR_OUTPUT": "outputVars", "VAR_IN_OUT": "inOutVars", "VAR": "localVars",
}  # fmt: skip
KINDS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock", "PROGRAM": "program"}
_ALWAYS = "2026-01-01T00:00:00"


def plcopen_xml(texts: Iterable[tuple[str, str]]) -> str:
    """The file's text of ``texts``: name without suffix and content."""
    root = _header()
    types, pous = (ET.SubElement(root[2], name) for name in ("dataTypes", "pous"))
    resource = root.find("instances/configurations/configuration/resource")
    assert resource is not None
    for stem, text in texts:
        bodies = {part.name: part.body for part in objects(stem, text) if part.body is not None}
        for declared in Parser(f"{stem}.st", text).declarations():
            if isinstance(declared, tree.TypeDeclaration):
                _data_type(types, declared)
            elif isinstance(declared, tree.Unit):
                _pou(pous, declared, bodies[declared.name])
            else:
                _globals(resource, stem, declared)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _header() -> ET.Element:
    root = ET.Element("project", {"xmlns": _NAMESPACE, "xmlns:xhtml": _XHTML})
    made = {"companyName": "Longreach", "productName": "Longreach", "productVersion": "1"}
    ET.SubElement(root, "fileHeader", made | {"creationDateTime": _ALWAYS})
    coordinates = ET.SubElement(ET.SubElement(root, "contentHeader", name="Longreach"), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(coordinates, language), "scaling", x="1", y="1")
    ET.SubElement(root, "types")
    configurations = ET.SubElement(ET.SubElement(root, "instances"), "configurations")
    configuration = ET.SubElement(configurations, "configuration", name="Longreach")
    ET.SubElement(configuration, "resource", name="Controller")
    return root


def _globals(resource: ET.Element, stem: str, declared: tree.Globals) -> None:
    constant = {"constant": "true"} if declared.declared and declared.declared[0].constant else {}
    part = "Constants" if constant else "Variables"
    made = ET.SubElement(resource, "globalVars", {"name": f"GVL_LR_{stem.title()}{part}"} | constant)
    for variable in declared.declared:
        _variable(made, variable)


def _data_type(types: ET.Element, declared: tree.TypeDeclaration) -> None:
    base = ET.SubElement(ET.SubElement(types, "dataType", name=declared.name), "baseType")
    if declared.alias is not None:
        _type(base, declared.alias)
    elif declared.members is not None:
        structure = ET.SubElement(base, "struct")
        for member in declared.members:
            _variable(structure, member)
    else:
        enumeration = ET.SubElement(base, "enum")
        values = ET.SubElement(enumeration, "values")
        for name, number, _ in declared.values or ():
            given = {} if number is None else {"value": _text(number)}
            ET.SubElement(values, "value", {"name": name} | given)
        ET.SubElement(ET.SubElement(enumeration, "baseType"), declared.base)


def _pou(pous: ET.Element, unit: tree.Unit, body: str) -> None:
    pou = ET.SubElement(pous, "pou", name=unit.name, pouType=KINDS[unit.kind])
    interface = ET.SubElement(pou, "interface")
    if unit.result_text is not None:
        _type(ET.SubElement(interface, "returnType"), unit.result_text)
    sections: list[tuple[str, list[tree.VariableDeclaration]]] = []
    for variable in unit.declared:  # in order: a call may go by it
        if not sections or sections[-1][0] != variable.section:
            sections.append((variable.section, []))
        sections[-1][1].append(variable)
    for section, variables in sections:
        made = ET.SubElement(interface, _LISTS[section])
        for variable in variables:
            _variable(made, variable)
    text = ET.SubElement(ET.SubElement(pou, "body"), "ST")
    ET.SubElement(text, "xhtml:p").text = body


def _variable(into: ET.Element, declared: tree.VariableDeclaration) -> None:
    made = ET.SubElement(into, "variable", name=declared.name)
    _type(ET.SubElement(made, "type"), declared.type)
    if declared.initial is not None:
        _value(ET.SubElement(made, "initialValue"), declared.initial.value)


def _type(into: ET.Element, of: tree.TypeText) -> None:
    if of.of is not None:
        array = ET.SubElement(into, "array")
        for lower, upper in of.bounds:
            ET.SubElement(array, "dimension", lower=_text(lower), upper=_text(upper))
        _type(ET.SubElement(array, "baseType"), of.of)
    elif of.name.upper() in _ELEMENTARY:
        ET.SubElement(into, of.name.upper())
    else:
        ET.SubElement(into, "derived", name=of.name)


def _value(into: ET.Element, value: object) -> None:
    if isinstance(value, tree.Initializer):
        _value(into, value.value)
    elif isinstance(value, list):
        array = ET.SubElement(into, "arrayValue")
        for each in value:
            _value(ET.SubElement(array, "value"), each)
    elif isinstance(value, dict):
        structure = ET.SubElement(into, "structValue")
        for name, each in value.items():
            _value(ET.SubElement(structure, "value", member=name), each)
    else:
        assert isinstance(value, tree.Expression)
        ET.SubElement(into, "simpleValue", value=_text(value))


def _text(expression: tree.Expression) -> str:
    """What a declaration can hold, as text again. Raises ValueError for more."""
    match expression:
        case tree.Literal(value=bool() as value):
            return "TRUE" if value else "FALSE"
        case tree.Literal(value=value):
            return repr(value).upper()
        case tree.Name(name=name):
            return name
        case tree.Member(of=of, name=name):
            return f"{_text(of)}.{name}"
        case tree.Unary(sign="-", operand=operand):
            return f"-{_text(operand)}"
        case tree.Binary(sign=sign, left=left, right=right):
            return f"({_text(left)} {sign} {_text(right)})"
    raise ValueError(f"line {expression.line}: no value of a declaration")


def shipped() -> list[tuple[str, str]]:
    """The texts of the program by name."""
    paths = [path for folder in ("docs/protocol", "plc") for path in sorted((ROOT / folder).glob("*.st"))]
    return [(path.stem, path.read_text(encoding="utf-8")) for path in paths]


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("which file? python -m tools.plcopen FILE.xml")
    Path(sys.argv[1]).write_text(plcopen_xml(shipped()), encoding="utf-8")
    print(f"{sys.argv[1]}: PLCopen XML, TC6 2.01")
