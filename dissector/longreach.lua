-- Wireshark dissector of the Longreach reference link (docs/protocol.md).
-- Use: wireshark -X lua_script:longreach.lua
-- Display filters: lrlk.kind, lrlk.session, lrlk.sequence, lrlk.command.code, lrlk.bad_crc, ...
local lrlk = Proto("lrlk", "Longreach reference link")
local f = {}
local names = {}
local layouts = {}
local sizes = {}

f["magic"] = ProtoField.string("lrlk.magic", "magic")
f["major"] = ProtoField.uint8("lrlk.major", "major", base.DEC)
f["minor"] = ProtoField.uint8("lrlk.minor", "minor", base.DEC)
f["kind"] = ProtoField.uint8("lrlk.kind", "kind", base.DEC, { [1] = "HELLO", [2] = "WELCOME", [3] = "HEARTBEAT", [4] = "HEARTBEAT_REPLY", [5] = "REFERENCE_POSE", [6] = "REFERENCE_PATH", [7] = "COMMAND", [8] = "ACKNOWLEDGEMENT", [9] = "STATE", [10] = "BYE", [11] = "STREAMED_POSE", [12] = "STREAM_REFUSED" })
f["spare"] = ProtoField.uint8("lrlk.spare", "spare", base.DEC)
f["flags"] = ProtoField.uint16("lrlk.flags", "flags", base.HEX)
f["payload_bytes"] = ProtoField.uint16("lrlk.payload_bytes", "payload_bytes (byte)", base.DEC)
f["crc32"] = ProtoField.uint32("lrlk.crc32", "crc32", base.HEX)
f["session"] = ProtoField.uint64("lrlk.session", "session", base.HEX)
f["sequence"] = ProtoField.uint32("lrlk.sequence", "sequence", base.DEC)
f["echo_sequence"] = ProtoField.uint32("lrlk.echo_sequence", "echo_sequence", base.DEC)
f["sent_ns"] = ProtoField.uint64("lrlk.sent_ns", "sent_ns (ns)", base.DEC)
local header_layout = {
  { f["magic"], 0, 4, 1, nil },
  { f["major"], 4, 1, 1, nil },
  { f["minor"], 5, 1, 1, nil },
  { f["kind"], 6, 1, 1, nil },
  { f["spare"], 7, 1, 1, nil },
  { f["flags"], 8, 2, 1, nil },
  { f["payload_bytes"], 10, 2, 1, nil },
  { f["crc32"], 12, 4, 1, nil },
  { f["session"], 16, 8, 1, nil },
  { f["sequence"], 24, 4, 1, nil },
  { f["echo_sequence"], 28, 4, 1, nil },
  { f["sent_ns"], 32, 8, 1, nil },
}
f["trailer.sequence_high"] = ProtoField.uint32("lrlk.trailer.sequence_high", "sequence_high", base.DEC)
f["trailer.key_id"] = ProtoField.uint32("lrlk.trailer.key_id", "key_id", base.HEX)
f["trailer.tag"] = ProtoField.bytes("lrlk.trailer.tag", "tag")
local trailer_layout = {
  { f["trailer.sequence_high"], 0, 4, 1, nil },
  { f["trailer.key_id"], 4, 4, 1, nil },
  { f["trailer.tag"], 8, 16, 1, nil },
}
names[1] = "HELLO"
sizes[1] = 32
f["hello.client_nonce"] = ProtoField.uint64("lrlk.hello.client_nonce", "client_nonce", base.HEX)
f["hello.capabilities"] = ProtoField.uint64("lrlk.hello.capabilities", "capabilities", base.HEX)
f["hello.arm_hash"] = ProtoField.uint64("lrlk.hello.arm_hash", "arm_hash", base.HEX)
f["hello.state_period_ms"] = ProtoField.uint32("lrlk.hello.state_period_ms", "state_period_ms (ms)", base.DEC)
layouts[1] = {
  { f["hello.client_nonce"], 0, 8, 1, nil },
  { f["hello.capabilities"], 8, 8, 1, nil },
  { f["hello.arm_hash"], 16, 8, 1, nil },
  { f["hello.state_period_ms"], 24, 4, 1, nil },
}
names[2] = "WELCOME"
sizes[2] = 48
f["welcome.client_nonce"] = ProtoField.uint64("lrlk.welcome.client_nonce", "client_nonce", base.HEX)
f["welcome.capabilities"] = ProtoField.uint64("lrlk.welcome.capabilities", "capabilities", base.HEX)
f["welcome.arm_hash"] = ProtoField.uint64("lrlk.welcome.arm_hash", "arm_hash", base.HEX)
f["welcome.boot_id"] = ProtoField.uint64("lrlk.welcome.boot_id", "boot_id", base.HEX)
f["welcome.cycle_ns"] = ProtoField.uint32("lrlk.welcome.cycle_ns", "cycle_ns (ns)", base.DEC)
f["welcome.link_timeout_ms"] = ProtoField.uint32("lrlk.welcome.link_timeout_ms", "link_timeout_ms (ms)", base.DEC)
f["welcome.state_period_ms"] = ProtoField.uint32("lrlk.welcome.state_period_ms", "state_period_ms (ms)", base.DEC)
layouts[2] = {
  { f["welcome.client_nonce"], 0, 8, 1, nil },
  { f["welcome.capabilities"], 8, 8, 1, nil },
  { f["welcome.arm_hash"], 16, 8, 1, nil },
  { f["welcome.boot_id"], 24, 8, 1, nil },
  { f["welcome.cycle_ns"], 32, 4, 1, nil },
  { f["welcome.link_timeout_ms"], 36, 4, 1, nil },
  { f["welcome.state_period_ms"], 40, 4, 1, nil },
}
names[3] = "HEARTBEAT"
sizes[3] = 8
f["heartbeat.sent_ns"] = ProtoField.uint64("lrlk.heartbeat.sent_ns", "sent_ns (ns)", base.DEC)
layouts[3] = {
  { f["heartbeat.sent_ns"], 0, 8, 1, nil },
}
names[4] = "HEARTBEAT_REPLY"
sizes[4] = 24
f["heartbeat_reply.sent_ns"] = ProtoField.uint64("lrlk.heartbeat_reply.sent_ns", "sent_ns (ns)", base.DEC)
f["heartbeat_reply.received_ns"] = ProtoField.uint64("lrlk.heartbeat_reply.received_ns", "received_ns (ns)", base.DEC)
f["heartbeat_reply.replied_ns"] = ProtoField.uint64("lrlk.heartbeat_reply.replied_ns", "replied_ns (ns)", base.DEC)
layouts[4] = {
  { f["heartbeat_reply.sent_ns"], 0, 8, 1, nil },
  { f["heartbeat_reply.received_ns"], 8, 8, 1, nil },
  { f["heartbeat_reply.replied_ns"], 16, 8, 1, nil },
}
names[5] = "REFERENCE_POSE"
sizes[5] = 72
f["reference_pose.command_id"] = ProtoField.uint64("lrlk.reference_pose.command_id", "command_id", base.DEC)
f["reference_pose.X_BT_ref"] = ProtoField.double("lrlk.reference_pose.X_BT_ref", "X_BT_ref (m, 1)")
f["reference_pose.duration_s"] = ProtoField.double("lrlk.reference_pose.duration_s", "duration_s (s)")
layouts[5] = {
  { f["reference_pose.command_id"], 0, 8, 1, nil },
  { f["reference_pose.X_BT_ref"], 8, 8, 7, {"x", "y", "z", "qw", "qx", "qy", "qz"} },
  { f["reference_pose.duration_s"], 64, 8, 1, nil },
}
names[6] = "REFERENCE_PATH"
sizes[6] = 1376
f["reference_path.command_id"] = ProtoField.uint64("lrlk.reference_path.command_id", "command_id", base.DEC)
f["reference_path.waypoint_count"] = ProtoField.uint32("lrlk.reference_path.waypoint_count", "waypoint_count", base.DEC)
f["reference_path.waypoints"] = ProtoField.double("lrlk.reference_path.waypoints", "waypoints (m, 1)")
f["reference_path.segment_s"] = ProtoField.double("lrlk.reference_path.segment_s", "segment_s (s)")
f["reference_path.dwell_s"] = ProtoField.double("lrlk.reference_path.dwell_s", "dwell_s (s)")
layouts[6] = {
  { f["reference_path.command_id"], 0, 8, 1, nil },
  { f["reference_path.waypoint_count"], 8, 4, 1, nil },
  { f["reference_path.waypoints"], 16, 8, 168, {"x", "y", "z", "qw", "qx", "qy", "qz"} },
  { f["reference_path.segment_s"], 1360, 8, 1, nil },
  { f["reference_path.dwell_s"], 1368, 8, 1, nil },
}
names[7] = "COMMAND"
sizes[7] = 16
f["command.command_id"] = ProtoField.uint64("lrlk.command.command_id", "command_id", base.DEC)
f["command.code"] = ProtoField.uint32("lrlk.command.code", "code", base.DEC, { [1] = "ENABLE", [2] = "DISABLE", [3] = "STOP", [4] = "RESET", [5] = "EMERGENCY_STOP", [6] = "EMERGENCY_RELEASE", [7] = "START_STREAM", [8] = "END_STREAM" })
layouts[7] = {
  { f["command.command_id"], 0, 8, 1, nil },
  { f["command.code"], 8, 4, 1, nil },
}
names[8] = "ACKNOWLEDGEMENT"
sizes[8] = 32
f["acknowledgement.command_id"] = ProtoField.uint64("lrlk.acknowledgement.command_id", "command_id", base.DEC)
f["acknowledgement.reason"] = ProtoField.uint32("lrlk.acknowledgement.reason", "reason", base.DEC, { [0] = "ACCEPTED", [1] = "DISABLED", [2] = "NOT_IN_ERROR", [3] = "ERROR_LATCHED", [4] = "EMERGENCY_LATCHED", [5] = "STOPPING", [6] = "ALREADY_DONE", [10] = "NOT_FINITE", [11] = "NOT_UNIT_QUATERNION", [12] = "OUTSIDE_WORKSPACE", [13] = "JOINT_LIMIT", [14] = "UNREACHABLE", [15] = "SINGULAR", [16] = "TOO_FAST", [17] = "TOO_FAR", [18] = "BAD_DURATION", [19] = "EMPTY_PATH", [20] = "TOO_MANY_WAYPOINTS", [21] = "PLANT_LINK_DOWN", [22] = "REFERENCE_LINK_DOWN", [23] = "PLANT_NOT_READY", [24] = "UNKNOWN_COMMAND", [25] = "REPEATED_COMMAND_ID", [26] = "OVERTAKEN", [27] = "NOT_NEGOTIATED", [28] = "MOVING", [29] = "STREAMING", [30] = "NOT_STREAMING", [31] = "STALE", [40] = "INCOMPATIBLE_VERSION", [41] = "WRONG_ARM", [42] = "SESSION_OCCUPIED", [43] = "UNKNOWN_SESSION", [44] = "PEER_RESTARTED", [45] = "LINK_TIMEOUT", [46] = "SHUTDOWN", [47] = "NOT_AUTHENTICATED", [48] = "KEY_NOT_CONFIGURED", [49] = "UNKNOWN_KEY", [50] = "BAD_TAG" })
f["acknowledgement.value"] = ProtoField.double("lrlk.acknowledgement.value", "value (SI)")
f["acknowledgement.limit"] = ProtoField.double("lrlk.acknowledgement.limit", "limit (SI)")
layouts[8] = {
  { f["acknowledgement.command_id"], 0, 8, 1, nil },
  { f["acknowledgement.reason"], 8, 4, 1, nil },
  { f["acknowledgement.value"], 16, 8, 1, nil },
  { f["acknowledgement.limit"], 24, 8, 1, nil },
}
names[9] = "STATE"
sizes[9] = 336
f["state.time_ns"] = ProtoField.uint64("lrlk.state.time_ns", "time_ns (ns)", base.DEC)
f["state.cycle"] = ProtoField.uint64("lrlk.state.cycle", "cycle", base.DEC)
f["state.group_state"] = ProtoField.uint16("lrlk.state.group_state", "group_state", base.DEC, { [0] = "DISABLED", [1] = "STANDBY", [2] = "MOVING", [3] = "STOPPING", [4] = "ERROR_STOP" })
f["state.fault"] = ProtoField.uint16("lrlk.state.fault", "fault", base.DEC, { [0] = "NONE", [1] = "PLANT_LINK_LOST", [2] = "PLANT_CYCLE_FROZEN", [3] = "REFERENCE_LINK_LOST", [4] = "FOLLOWING_ERROR", [5] = "ENCODER_JUMP", [6] = "ENCODER_STUCK", [7] = "JOINT_LIMIT", [8] = "WORKSPACE_LIMIT", [9] = "OVERSPEED", [10] = "SUPPLY_PRESSURE_LOST", [11] = "PLANT_WATCHDOG", [12] = "EMERGENCY_STOP", [13] = "NUMERIC", [14] = "OVERRUN", [15] = "PLANT_STATUS", [16] = "REFERENCE_STALE" })
f["state.severity"] = ProtoField.uint16("lrlk.state.severity", "severity", base.DEC, { [0] = "NONE", [1] = "WARNING", [2] = "STOP", [3] = "EMERGENCY" })
f["state.flags"] = ProtoField.uint16("lrlk.state.flags", "flags", base.HEX)
f["state.motion_id"] = ProtoField.uint64("lrlk.state.motion_id", "motion_id", base.DEC)
f["state.motion_done"] = ProtoField.uint32("lrlk.state.motion_done", "motion_done", base.DEC)
f["state.segment"] = ProtoField.uint32("lrlk.state.segment", "segment", base.DEC)
f["state.q_meas"] = ProtoField.double("lrlk.state.q_meas", "q_meas (rad)")
f["state.q_cmd"] = ProtoField.double("lrlk.state.q_cmd", "q_cmd (rad)")
f["state.valves"] = ProtoField.double("lrlk.state.valves", "valves (1)")
f["state.X_BT"] = ProtoField.double("lrlk.state.X_BT", "X_BT (m, 1)")
f["state.X_BT_cmd"] = ProtoField.double("lrlk.state.X_BT_cmd", "X_BT_cmd (m, 1)")
f["state.supply_bar"] = ProtoField.double("lrlk.state.supply_bar", "supply_bar (bar)")
f["state.overruns"] = ProtoField.uint32("lrlk.state.overruns", "overruns", base.DEC)
f["state.lateness_p50_us"] = ProtoField.uint32("lrlk.state.lateness_p50_us", "lateness_p50_us (µs)", base.DEC)
f["state.lateness_p99_us"] = ProtoField.uint32("lrlk.state.lateness_p99_us", "lateness_p99_us (µs)", base.DEC)
f["state.lateness_max_us"] = ProtoField.uint32("lrlk.state.lateness_max_us", "lateness_max_us (µs)", base.DEC)
f["state.references_lost"] = ProtoField.uint32("lrlk.state.references_lost", "references_lost", base.DEC)
f["state.references_dropped"] = ProtoField.uint32("lrlk.state.references_dropped", "references_dropped", base.DEC)
f["state.plant_exchange_failures"] = ProtoField.uint32("lrlk.state.plant_exchange_failures", "plant_exchange_failures", base.DEC)
f["state.stream_number"] = ProtoField.uint32("lrlk.state.stream_number", "stream_number", base.DEC)
layouts[9] = {
  { f["state.time_ns"], 0, 8, 1, nil },
  { f["state.cycle"], 8, 8, 1, nil },
  { f["state.group_state"], 16, 2, 1, nil },
  { f["state.fault"], 18, 2, 1, nil },
  { f["state.severity"], 20, 2, 1, nil },
  { f["state.flags"], 22, 2, 1, nil },
  { f["state.motion_id"], 24, 8, 1, nil },
  { f["state.motion_done"], 32, 4, 1, nil },
  { f["state.segment"], 36, 4, 1, nil },
  { f["state.q_meas"], 40, 8, 6, nil },
  { f["state.q_cmd"], 88, 8, 6, nil },
  { f["state.valves"], 136, 8, 6, nil },
  { f["state.X_BT"], 184, 8, 7, {"x", "y", "z", "qw", "qx", "qy", "qz"} },
  { f["state.X_BT_cmd"], 240, 8, 7, {"x", "y", "z", "qw", "qx", "qy", "qz"} },
  { f["state.supply_bar"], 296, 8, 1, nil },
  { f["state.overruns"], 304, 4, 1, nil },
  { f["state.lateness_p50_us"], 308, 4, 1, nil },
  { f["state.lateness_p99_us"], 312, 4, 1, nil },
  { f["state.lateness_max_us"], 316, 4, 1, nil },
  { f["state.references_lost"], 320, 4, 1, nil },
  { f["state.references_dropped"], 324, 4, 1, nil },
  { f["state.plant_exchange_failures"], 328, 4, 1, nil },
  { f["state.stream_number"], 332, 4, 1, nil },
}
names[10] = "BYE"
sizes[10] = 8
f["bye.reason"] = ProtoField.uint32("lrlk.bye.reason", "reason", base.DEC, { [0] = "ACCEPTED", [1] = "DISABLED", [2] = "NOT_IN_ERROR", [3] = "ERROR_LATCHED", [4] = "EMERGENCY_LATCHED", [5] = "STOPPING", [6] = "ALREADY_DONE", [10] = "NOT_FINITE", [11] = "NOT_UNIT_QUATERNION", [12] = "OUTSIDE_WORKSPACE", [13] = "JOINT_LIMIT", [14] = "UNREACHABLE", [15] = "SINGULAR", [16] = "TOO_FAST", [17] = "TOO_FAR", [18] = "BAD_DURATION", [19] = "EMPTY_PATH", [20] = "TOO_MANY_WAYPOINTS", [21] = "PLANT_LINK_DOWN", [22] = "REFERENCE_LINK_DOWN", [23] = "PLANT_NOT_READY", [24] = "UNKNOWN_COMMAND", [25] = "REPEATED_COMMAND_ID", [26] = "OVERTAKEN", [27] = "NOT_NEGOTIATED", [28] = "MOVING", [29] = "STREAMING", [30] = "NOT_STREAMING", [31] = "STALE", [40] = "INCOMPATIBLE_VERSION", [41] = "WRONG_ARM", [42] = "SESSION_OCCUPIED", [43] = "UNKNOWN_SESSION", [44] = "PEER_RESTARTED", [45] = "LINK_TIMEOUT", [46] = "SHUTDOWN", [47] = "NOT_AUTHENTICATED", [48] = "KEY_NOT_CONFIGURED", [49] = "UNKNOWN_KEY", [50] = "BAD_TAG" })
layouts[10] = {
  { f["bye.reason"], 0, 4, 1, nil },
}
names[11] = "STREAMED_POSE"
sizes[11] = 128
f["streamed_pose.stream_id"] = ProtoField.uint64("lrlk.streamed_pose.stream_id", "stream_id", base.DEC)
f["streamed_pose.number"] = ProtoField.uint32("lrlk.streamed_pose.number", "number", base.DEC)
f["streamed_pose.time_ns"] = ProtoField.uint64("lrlk.streamed_pose.time_ns", "time_ns (ns)", base.DEC)
f["streamed_pose.X_BT_ref"] = ProtoField.double("lrlk.streamed_pose.X_BT_ref", "X_BT_ref (m, 1)")
f["streamed_pose.twist_ref"] = ProtoField.double("lrlk.streamed_pose.twist_ref", "twist_ref (m/s, rad/s)")
layouts[11] = {
  { f["streamed_pose.stream_id"], 0, 8, 1, nil },
  { f["streamed_pose.number"], 8, 4, 1, nil },
  { f["streamed_pose.time_ns"], 16, 8, 1, nil },
  { f["streamed_pose.X_BT_ref"], 24, 8, 7, {"x", "y", "z", "qw", "qx", "qy", "qz"} },
  { f["streamed_pose.twist_ref"], 80, 8, 6, nil },
}
names[12] = "STREAM_REFUSED"
sizes[12] = 32
f["stream_refused.stream_id"] = ProtoField.uint64("lrlk.stream_refused.stream_id", "stream_id", base.DEC)
f["stream_refused.number"] = ProtoField.uint32("lrlk.stream_refused.number", "number", base.DEC)
f["stream_refused.reason"] = ProtoField.uint32("lrlk.stream_refused.reason", "reason", base.DEC, { [0] = "ACCEPTED", [1] = "DISABLED", [2] = "NOT_IN_ERROR", [3] = "ERROR_LATCHED", [4] = "EMERGENCY_LATCHED", [5] = "STOPPING", [6] = "ALREADY_DONE", [10] = "NOT_FINITE", [11] = "NOT_UNIT_QUATERNION", [12] = "OUTSIDE_WORKSPACE", [13] = "JOINT_LIMIT", [14] = "UNREACHABLE", [15] = "SINGULAR", [16] = "TOO_FAST", [17] = "TOO_FAR", [18] = "BAD_DURATION", [19] = "EMPTY_PATH", [20] = "TOO_MANY_WAYPOINTS", [21] = "PLANT_LINK_DOWN", [22] = "REFERENCE_LINK_DOWN", [23] = "PLANT_NOT_READY", [24] = "UNKNOWN_COMMAND", [25] = "REPEATED_COMMAND_ID", [26] = "OVERTAKEN", [27] = "NOT_NEGOTIATED", [28] = "MOVING", [29] = "STREAMING", [30] = "NOT_STREAMING", [31] = "STALE", [40] = "INCOMPATIBLE_VERSION", [41] = "WRONG_ARM", [42] = "SESSION_OCCUPIED", [43] = "UNKNOWN_SESSION", [44] = "PEER_RESTARTED", [45] = "LINK_TIMEOUT", [46] = "SHUTDOWN", [47] = "NOT_AUTHENTICATED", [48] = "KEY_NOT_CONFIGURED", [49] = "UNKNOWN_KEY", [50] = "BAD_TAG" })
f["stream_refused.value"] = ProtoField.double("lrlk.stream_refused.value", "value (SI)")
f["stream_refused.limit"] = ProtoField.double("lrlk.stream_refused.limit", "limit (SI)")
layouts[12] = {
  { f["stream_refused.stream_id"], 0, 8, 1, nil },
  { f["stream_refused.number"], 8, 4, 1, nil },
  { f["stream_refused.reason"], 12, 4, 1, nil },
  { f["stream_refused.value"], 16, 8, 1, nil },
  { f["stream_refused.limit"], 24, 8, 1, nil },
}

local HEADER_BYTES = 40
local SEQUENCE_OFFSET = 24
local FLAGS_OFFSET = 8
local AUTHENTICATED = 256
local TRAILER_BYTES = 24
local CRC_OFFSET = 12
local CRC_END = 16
local MAJOR = 1
local MAGIC = "LRLK"
local PORT = 47000
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
