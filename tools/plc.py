"""IEC 61131-3: types, readers and writers of the protocol in structured text."""

from collections.abc import Iterable

from protocol.datagram_layout import (
    HEADER,
    HEADER_BYTES,
    MAGIC,
    MAX_DATAGRAM_BYTES,
    PAYLOADS,
    TRAILER,
    VERSION_MAJOR,
    Field,
    Kind,
    offsets,
    size_of,
)
from protocol.process_image import INPUT_TABLE, INPUT_WORDS, OUTPUT_TABLE, OUTPUT_WORDS, Register

IEC = {"B": "USINT", "H": "UINT", "I": "UDINT", "Q": "ULINT", "d": "LREAL", "x": "BYTE"} | {
    "4s": "BYTE",
    "16s": "BYTE",
}
IEC_WORDS = {"H": "UINT", "h": "INT", "i": "DINT"}
# LIMIT is a standard function of IEC 61131-3, so it cannot name a member.
IEC_NAMES = {"limit": "limit_value"}
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

_HEAD = """\
(* Longreach: types of the reference link and of the process image (docs/protocol.md, annex A).
   Made from the tables that the code runs on: python -m tools.protocol_files

   TwinCAT 3 and CODESYS lay them out as the datagrams are, whatever their pack mode is: there a datagram can
   be copied into the type of its kind. Other runtimes may keep more beside a variable than its value
   (OpenPLC's keeps what is forced): there fields.st reads and writes the same types field by field. *)
"""


def types() -> str:
    """Structures of every datagram, of its parts, and of both process images."""
    parts = [_HEAD]
    parts += _alias("T_LR_Datagram", MAX_DATAGRAM_BYTES, "BYTE")
    parts += _alias("T_LR_InputWords", INPUT_WORDS, "UINT")
    parts += _alias("T_LR_OutputWords", OUTPUT_WORDS, "UINT")
    parts += ["TYPE", "ST_LR_Pose : STRUCT (* of T in B; m, and a unit quaternion *)"]
    parts += [f"    {name} : LREAL;" for name in POSE]
    parts += ["END_STRUCT", "END_TYPE", ""]
    parts += _struct("ST_LR_Header", HEADER)
    for kind, fields in PAYLOADS.items():
        parts += _struct(structure_of(kind), fields, "    header : ST_LR_Header;")
    parts += _struct("ST_LR_Trailer", TRAILER)
    for name, rows in (("ST_LR_Inputs", INPUT_TABLE), ("ST_LR_Outputs", OUTPUT_TABLE)):
        parts += ["TYPE", f"{name} : STRUCT"]
        parts += [f"    {row.name} : {_array(row.count, IEC_WORDS[row.code])};" for row in rows]
        parts += ["END_STRUCT", "END_TYPE", ""]
    return "\n".join(parts).rstrip() + "\n"


def camel(kind: Kind) -> str:
    """The kind's name as the types have it."""
    return "".join(word.capitalize() for word in kind.name.split("_"))


def structure_of(kind: Kind) -> str:
    """The name of the kind's type."""
    return f"ST_LR_{camel(kind)}"


def _alias(name: str, count: int, kind: str) -> list[str]:
    return ["TYPE", f"{name} : {_array(count, kind)};", "END_TYPE", ""]


def _struct(name: str, layout: tuple[Field, ...], first: str | None = None) -> list[str]:
    members = [f"    {member_name(field)} : {_iec_type(field)};" for field in layout]
    return ["TYPE", f"{name} : STRUCT", *([first] if first else []), *members, "END_STRUCT", "END_TYPE", ""]


def member_name(field: Field) -> str:
    """The field's name as a member of a type."""
    return IEC_NAMES.get(field.name, field.name)


def _iec_type(field: Field) -> str:
    if field.code.endswith("s"):
        return _array(field.size, "BYTE")
    return _array(field.poses, "ST_LR_Pose") if field.poses else _array(field.count, IEC[field.code])


def _array(count: int, kind: str) -> str:
    return f"ARRAY[0..{count - 1}] OF {kind}" if count > 1 else kind


_ACCESS = {"H": "Uint", "I": "Udint", "Q": "Ulint"}
_FIELDS_HEAD = """\
(* Longreach: every datagram and both process images, field by field (docs/protocol.md, annex A).
   Made from the tables that the code runs on: python -m tools.protocol_files
   Needs types_twincat_codesys.st and helpers.st; no pointers, no overlaid types: for every IEC 61131-3
   runtime.

   F_LR_Read...  fills the structure and returns TRUE if every LREAL of it is a number that 3.7 allows.
                 Check the datagram before (3.5); offsets in it are fixed.
   F_LR_Write... writes magic, version, kind, length, payload and CRC, and returns how many bytes to send:
                 0 if an LREAL is no finite number. session, sequence, sent_ns, flags and minor are those of
                 the structure's header. A signed datagram needs F_LR_WriteTrailer, and then the CRC of all
                 of it (11.3). *)
"""


def fields() -> str:
    """Readers and writers of every structure of ``types``."""
    parts = [_FIELDS_HEAD]
    parts += _reader("Pose", "ST_LR_Pose", _pose_fields(), at="nAt")
    parts += _writer_part("Pose", "ST_LR_Pose", _pose_fields())
    parts += _reader("Header", "ST_LR_Header", HEADER, at=None)
    parts += _header_writer()
    parts += _reader("Trailer", "ST_LR_Trailer", TRAILER, at="nAt")
    parts += _writer_part("Trailer", "ST_LR_Trailer", TRAILER)
    for kind, layout in PAYLOADS.items():
        parts += _reader(camel(kind), structure_of(kind), layout, at=None, first=HEADER_BYTES)
        parts += _writer(kind, layout)
    parts += _image_reader() + _image_writer()
    return "\n".join(parts).rstrip() + "\n"


def _pose_fields() -> tuple[Field, ...]:
    return tuple(Field(name, "d", 1, "", "") for name in POSE)


def _function(name: str, result: str, parameters: dict[str, list[str]], body: Iterable[str]) -> list[str]:
    lines = [f"FUNCTION {name} : {result}"]
    for section, variables in parameters.items():
        if variables:
            lines += [section, *(f"    {variable};" for variable in variables), "END_VAR"]
    return [*lines, *body, "END_FUNCTION", ""]


def _reader(
    name: str, structure: str, layout: tuple[Field, ...], *, at: str | None, first: int = 0
) -> list[str]:
    """A reader from offset ``nAt`` on, or with ``at`` None from ``first`` bytes on."""
    header = "F_LR_ReadHeader(aData := aData, stHeader := stData.header)" if first else "TRUE"
    body = [f"xFinite := {header};"]
    for field, offset in zip(layout, offsets(layout), strict=True):
        body += _reading_lines(field, f"{at} + {offset}" if at else str(first + offset))
    loops = [f for f in layout if _is_array(f)]
    target = "stHeader" if name == "Header" else "stData"
    parameters = {
        "VAR_IN_OUT": ["aData : T_LR_Datagram", f"{target} : {structure}"],
        "VAR_INPUT": ["nAt : UINT"] if at else [],
        "VAR": ["xFinite : BOOL", *(["i : UINT"] if loops else [])],
    }
    body = [line.replace("stData.", f"{target}.") if target != "stData" else line for line in body]
    return _function(f"F_LR_Read{name}", "BOOL", parameters, [*body, f"F_LR_Read{name} := xFinite;"])


def _is_array(field: Field) -> bool:
    return field.code.endswith("s") or field.code == "x" or (field.poses or field.count) > 1


def _loop(count: int, statement: str) -> list[str]:
    return [f"FOR i := 0 TO {count - 1} DO", f"    {statement}", "END_FOR"]


def _reading_lines(field: Field, at: str) -> list[str]:
    name = f"stData.{member_name(field)}"
    if field.code.endswith("s") or field.code == "x":
        return _loop(field.size, f"{name}[i] := aData[{at} + i];")
    if field.poses == 1:
        return [f"xFinite := F_LR_ReadPose(aData := aData, stData := {name}, nAt := {at}) AND xFinite;"]
    if field.poses:
        call = f"F_LR_ReadPose(aData := aData, stData := {name}[i], nAt := {at} + i * 56)"
        return _loop(field.poses, f"xFinite := {call} AND xFinite;")
    if field.code == "B":
        return [f"{name} := BYTE_TO_USINT(aData[{at}]);"]
    if field.code == "d":
        call = "F_LR_GetLreal(aData := aData, xFinite := xFinite, nAt := {})"
        if field.count > 1:
            return _loop(field.count, f"{name}[i] := {call.format(f'{at} + i * 8')};")
        return [f"{name} := {call.format(at)};"]
    return [f"{name} := F_LR_Get{_ACCESS[field.code]}(aData := aData, nAt := {at});"]


def _writing_lines(field: Field, at: str) -> list[str]:
    name = f"stData.{member_name(field)}"
    if field.code == "x":
        return _loop(field.size, f"aData[{at} + i] := 0;")
    if field.code.endswith("s"):
        return _loop(field.size, f"aData[{at} + i] := {name}[i];")
    if field.poses == 1:
        return [f"xFinite := F_LR_WritePose(aData := aData, stData := {name}, nAt := {at}) AND xFinite;"]
    if field.poses:
        call = f"F_LR_WritePose(aData := aData, stData := {name}[i], nAt := {at} + i * 56)"
        return _loop(field.poses, f"xFinite := {call} AND xFinite;")
    if field.code == "B":
        return [f"aData[{at}] := USINT_TO_BYTE({name});"]
    if field.code == "d":
        call = "F_LR_PutLreal(aData := aData, nAt := {}, fValue := {}) AND xFinite"
        if field.count > 1:
            return _loop(field.count, f"xFinite := {call.format(f'{at} + i * 8', name + '[i]')};")
        return [f"xFinite := {call.format(at, name)};"]
    put = f"F_LR_Put{_ACCESS[field.code]}(aData := aData, nAt := {at}, nValue := {name})"
    return [f"xFinite := {put} AND xFinite;"]


def _writer_part(name: str, structure: str, layout: tuple[Field, ...]) -> list[str]:
    body = ["xFinite := TRUE;"]
    for field, offset in zip(layout, offsets(layout), strict=True):
        body += _writing_lines(field, f"nAt + {offset}")
    parameters = {
        "VAR_IN_OUT": ["aData : T_LR_Datagram", f"stData : {structure}"],
        "VAR_INPUT": ["nAt : UINT"],
        "VAR": ["xFinite : BOOL", *(["i : UINT"] if any(map(_is_array, layout)) else [])],
    }
    return _function(f"F_LR_Write{name}", "BOOL", parameters, [*body, f"F_LR_Write{name} := xFinite;"])


def _header_writer() -> list[str]:
    """Constants and what the caller gives; the CRC is the datagram's writer's."""
    constants = {"major": VERSION_MAJOR, "spare": 0}
    body = ["xFinite := TRUE;"]
    for field, offset in zip(HEADER, offsets(HEADER), strict=True):
        if field.name == "magic":
            body += [f"aData[{offset + i}] := 16#{byte:02X};" for i, byte in enumerate(MAGIC)]
        elif field.name in constants:
            body.append(f"aData[{offset}] := {constants[field.name]};")
        elif field.name != "crc32":
            body += [line.replace("stData.", "stHeader.") for line in _writing_lines(field, str(offset))]
    parameters = {
        "VAR_IN_OUT": ["aData : T_LR_Datagram", "stHeader : ST_LR_Header"],
        "VAR": ["xFinite : BOOL"],
    }
    return _function("F_LR_WriteHeader", "BOOL", parameters, [*body, "F_LR_WriteHeader := xFinite;"])


def _writer(kind: Kind, layout: tuple[Field, ...]) -> list[str]:
    name, size = camel(kind), HEADER_BYTES + size_of(layout)
    crc_at = offsets(HEADER)[[field.name for field in HEADER].index("crc32")]
    body = [
        f"stData.header.kind := {kind.value};",
        f"stData.header.payload_bytes := {size_of(layout)};",
        "xFinite := F_LR_WriteHeader(aData := aData, stHeader := stData.header);",
    ]
    for field, offset in zip(layout, offsets(layout), strict=True):
        body += _writing_lines(field, str(HEADER_BYTES + offset))
    body += [
        f"stData.header.crc32 := F_LR_DatagramCrc(aData := aData, nBytes := {size});",
        f"xFinite := F_LR_PutUdint(aData := aData, nAt := {crc_at}, nValue := stData.header.crc32)"
        " AND xFinite;",
        f"F_LR_Write{name} := 0;",
        "IF xFinite THEN",
        f"    F_LR_Write{name} := {size};",
        "END_IF",
    ]
    parameters = {
        "VAR_IN_OUT": ["aData : T_LR_Datagram", f"stData : {structure_of(kind)}"],
        "VAR": ["xFinite : BOOL", *(["i : UINT"] if any(map(_is_array, layout)) else [])],
    }
    return _function(f"F_LR_Write{name}", "UINT", parameters, body)


def _image_reader() -> list[str]:
    body = []
    for row in INPUT_TABLE:
        body += _of_words(row, INPUT_TABLE[0].address)
    parameters = {
        "VAR_IN_OUT": ["aWords : T_LR_InputWords", "stData : ST_LR_Inputs"],
        "VAR": ["i : UINT"],
    }
    whole = "F_LR_ReadInputs := stData.plant_cycle = stData.plant_cycle_again; (* else torn: 10.3 *)"
    return _function("F_LR_ReadInputs", "BOOL", parameters, [*body, whole])


def _of_words(row: Register, start: int) -> list[str]:
    at, name = row.address - start, f"stData.{row.name}"
    value = {
        "H": "aWords[{}]",
        "h": "F_LR_WordToInt(nWord := aWords[{}])",
        "i": "F_LR_WordsToDint(nLow := aWords[{}], nHigh := aWords[{} + 1])",
    }[row.code]
    if row.count == 1:
        return [f"{name} := {value.format(at, at)};"]
    step = f"{at} + i * 2" if row.code == "i" else f"{at} + i"
    return _loop(row.count, f"{name}[i] := {value.format(step, step)};")


def _image_writer() -> list[str]:
    body = []
    for row in OUTPUT_TABLE:
        at, name = row.address - OUTPUT_TABLE[0].address, f"stData.{row.name}"
        value = "F_LR_IntToWord(nValue := {})" if row.code == "h" else "{}"
        if row.reserved:
            body += _loop(row.count, f"aWords[{at} + i] := 0;")
        elif row.closes:
            body.append(f"aWords[{at}] := stData.{OUTPUT_TABLE[0].name}; (* closes the image: 10.3 *)")
        elif row.count == 1:
            body.append(f"aWords[{at}] := {value.format(name)};")
        else:
            body += _loop(row.count, f"aWords[{at} + i] := {value.format(f'{name}[i]')};")
    parameters = {
        "VAR_IN_OUT": ["aWords : T_LR_OutputWords", "stData : ST_LR_Outputs"],
        "VAR": ["i : UINT"],
    }
    return _function("F_LR_WriteOutputs", "BOOL", parameters, [*body, "F_LR_WriteOutputs := TRUE;"])
