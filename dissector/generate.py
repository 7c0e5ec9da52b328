"""Wireshark's dissector of the reference link, in Lua, from the codec's own tables.

``python -m dissector.generate`` writes longreach.lua beside this file; a test compares the two.
"""

from enum import IntEnum
from pathlib import Path

from protocol.datagram_layout import (
    CRC_BYTES,
    CRC_OFFSET,
    FLAG_AUTHENTICATED,
    HEADER,
    HEADER_BYTES,
    MAGIC,
    PAYLOADS,
    TRAILER,
    TRAILER_BYTES,
    VERSION_MAJOR,
    Field,
    Kind,
    offsets,
    size_of,
)

SCRIPT = Path(__file__).with_name("longreach.lua")
PORT = 47_000
_TYPES = {
    "B": "uint8",
    "H": "uint16",
    "I": "uint32",
    "Q": "uint64",
    "d": "double",
    "4s": "string",
    "16s": "bytes",
}
_HEX = ("flags", "session", "crc32", "capabilities", "arm_hash", "boot_id", "client_nonce", "key_id")
_POSE_PARTS = ("x", "y", "z", "qw", "qx", "qy", "qz")

_HEAD = """\
-- Wireshark dissector of the Longreach reference link (docs/protocol.md). Made by dissector.generate
-- from the tables of the codec: do not edit. Use: wireshark -X lua_script:longreach.lua
-- Display filters: lrlk.kind, lrlk.session, lrlk.sequence, lrlk.command.code, lrlk.bad_crc, ...
local lrlk = Proto("lrlk", "Longreach reference link")
local f = {}
local names = {}
local layouts = {}
local sizes = {}
"""
_TAIL = """\
lrlk.fields = f

local bad_crc = ProtoExpert.new("lrlk.bad_crc", "CRC-32 does not match", expert.group.CHECKSUM,
                                expert.severity.ERROR)
local malformed = ProtoExpert.new("lrlk.malformed", "Not a datagram of this version", expert.group.MALFORMED,
                                  expert.severity.ERROR)
lrlk.experts = { bad_crc, malformed }

local crc_table = {}
for n = 0, 255 do
  local c = n
  for _ = 1, 8 do
    if bit.band(c, 1) == 1 then
      c = bit.bxor(bit.rshift(c, 1), 0xEDB88320)
    else
      c = bit.rshift(c, 1)
    end
  end
  crc_table[n] = c
end

local function crc32(bytes, from, to, c)
  for i = from, to do
    c = bit.bxor(bit.rshift(c, 8), crc_table[bit.band(bit.bxor(c, bytes:get_index(i)), 0xFF)])
  end
  return c
end

local function show(tree, buffer, layout, base)
  for _, row in ipairs(layout) do
    local field, offset, size, count, parts = row[1], row[2], row[3], row[4], row[5]
    for i = 0, count - 1 do
      local item = tree:add_le(field, buffer(base + offset + i * size, size))
      if count > 1 then
        local text = " [" .. i .. "]"
        if parts then text = " [" .. math.floor(i / #parts) .. "]." .. parts[i % #parts + 1] end
        item:append_text(text)
      end
    end
  end
end

function lrlk.dissector(buffer, pinfo, tree)
  local length = buffer:len()
  if length < 4 or buffer(0, 4):string() ~= MAGIC then return 0 end
  pinfo.cols.protocol = "LRLK"
  local root = tree:add(lrlk, buffer())
  if length < HEADER_BYTES then
    root:add_proto_expert_info(malformed, "shorter than a header")
    return length
  end
  show(root, buffer, header_layout, 0)
  local major = buffer(4, 1):uint()
  local kind = buffer(6, 1):uint()
  local name = names[kind] or ("kind " .. kind)
  pinfo.cols.info = name .. " seq=" .. buffer(SEQUENCE_OFFSET, 4):le_uint()
  root:append_text(", " .. name)
  if major ~= MAJOR then
    root:add_proto_expert_info(malformed, "major version " .. major)
    return length
  end
  local bytes = buffer:bytes()
  local sum = bit.bnot(crc32(bytes, CRC_END, length - 1, crc32(bytes, 0, CRC_OFFSET - 1, 0xFFFFFFFF)))
  if bit.tobit(sum) ~= bit.tobit(buffer(CRC_OFFSET, 4):le_uint()) then
    root:add_proto_expert_info(bad_crc)
  end
  local layout = layouts[kind]
  local signed = bit.band(buffer(FLAGS_OFFSET, 2):le_uint(), AUTHENTICATED) ~= 0
  local trailer = signed and TRAILER_BYTES or 0
  if layout == nil or length ~= HEADER_BYTES + sizes[kind] + trailer then
    root:add_proto_expert_info(malformed, "kind " .. kind .. " with " .. length .. " bytes")
    return length
  end
  show(root:add(lrlk, buffer(HEADER_BYTES, sizes[kind]), name), buffer, layout, HEADER_BYTES)
  if signed then
    local at = HEADER_BYTES + sizes[kind]
    pinfo.cols.info:append(" signed")
    show(root:add(lrlk, buffer(at), "trailer"), buffer, trailer_layout, at)
  end
  return length
end

local function heuristic(buffer, pinfo, tree)
  if buffer:len() < HEADER_BYTES or buffer(0, 4):string() ~= MAGIC then return false end
  lrlk.dissector(buffer, pinfo, tree)
  return true
end

lrlk:register_heuristic("udp", heuristic)
DissectorTable.get("udp.port"):add(PORT, lrlk)
"""


def dissector() -> str:
    """The whole script."""
    at = dict(zip((field.name for field in HEADER), offsets(HEADER), strict=True))
    lines = [_HEAD, *_layout("header_layout", "", HEADER), *_layout("trailer_layout", "trailer.", TRAILER)]
    for kind, fields in PAYLOADS.items():
        name = kind.name.lower()
        lines += [
            f'names[{kind.value}] = "{kind.name}"',
            f"sizes[{kind.value}] = {size_of(fields)}",
            *_layout(f"layouts[{kind.value}]", f"{name}.", fields),
        ]

    constants = {
        "HEADER_BYTES": HEADER_BYTES,
        "SEQUENCE_OFFSET": at["sequence"],
        "FLAGS_OFFSET": at["flags"],
        "AUTHENTICATED": FLAG_AUTHENTICATED,
        "TRAILER_BYTES": TRAILER_BYTES,
        "CRC_OFFSET": CRC_OFFSET,
        "CRC_END": CRC_OFFSET + CRC_BYTES,
        "MAJOR": VERSION_MAJOR,
        "MAGIC": f'"{MAGIC.decode()}"',
        "PORT": PORT,
    }
    declared = "".join(f"local {name} = {value}\n" for name, value in constants.items())
    return "\n".join(lines) + "\n\n" + declared + _TAIL


def _layout(target: str, prefix: str, fields: tuple[Field, ...]) -> list[str]:
    lines, rows = [], []
    for field, offset in zip(fields, offsets(fields), strict=True):
        if field.code == "x":
            continue
        key = f"{prefix}{field.name}"
        lines.append(f'f["{key}"] = {_proto_field(key, field)}')
        size = field.size // field.count
        parts = "{" + ", ".join(f'"{part}"' for part in _POSE_PARTS) + "}" if field.poses else "nil"
        rows.append(f'  {{ f["{key}"], {offset}, {size}, {field.count}, {parts} }},')
    declaration = target if "[" in target else f"local {target}"
    return [*lines, f"{declaration} = {{", *rows, "}"]


def _proto_field(key: str, field: Field) -> str:
    label = field.name + (f" ({field.unit})" if field.unit and field.unit != "bits" else "")
    kind = _TYPES[field.code]
    if kind in ("double", "string", "bytes"):
        return f'ProtoField.{kind}("lrlk.{key}", "{label}")'
    base = "base.HEX" if field.name in _HEX else "base.DEC"
    values = f", {_value_table(field.enum)}" if field.enum is not None else ""
    return f'ProtoField.{kind}("lrlk.{key}", "{label}", {base}{values})'


def _value_table(members: type[IntEnum]) -> str:
    return "{ " + ", ".join(f'[{member.value}] = "{member.name}"' for member in members) + " }"


if __name__ == "__main__":
    assert set(PAYLOADS) == set(Kind)
    SCRIPT.write_text(dissector(), encoding="utf-8")
