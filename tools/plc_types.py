"""IEC 61131-3 types of every datagram, of its parts and of both process images, out of the tables."""

from protocol.datagram_layout import (
    HEADER,
    MAX_DATAGRAM_BYTES,
    PAYLOADS,
    TRAILER,
    Field,
    Kind,
)
from protocol.process_image import INPUT_TABLE, INPUT_WORDS, OUTPUT_TABLE, OUTPUT_WORDS

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
