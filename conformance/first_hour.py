"""The order in which somebody who implements from scratch can pass the cases, with what to write for each."""

from typing import NamedTuple


class FirstHourStep(NamedTuple):
    """A case, and which part to write for it to pass."""

    number: int
    hint: str


# fmt: off - one row a step reads as the list that it is
REFERENCE_STEPS = tuple(
    FirstHourStep(*row)
    for row in (
        (
            200,
            "Bind the UDP port and answer HELLO with WELCOME: read the header at the offsets of 3.1, check "
            "magic, major, payload_bytes and CRC (3.2; annex B has it), draw a session number of 64 random "
            "bits, repeat the nonce. Compare your bytes with annex C.",
        ),
        (
            317,
            "Answer HEARTBEAT at once with HEARTBEAT_REPLY: its sent_ns, then receipt and reply on a "
            "monotonic clock (5.5). The session begins with the client's first datagram in it.",
        ),
        (201, "Fill WELCOME: boot_id drawn at start and never 0, cycle_ns, link_timeout_ms, arm_hash (4.2)."),
        (208, "Answer a repeated HELLO (same source, same nonce) with the same WELCOME again (4.6)."),
        (413, "Send STATE at the granted period, sampled in one scan, with cycle and time_ns (7.7, 3.9)."),
        (311, "Number every datagram you send one by one, WELCOME first (5.1)."),
        (412, "Fill STATE: poses with unit quaternions, joints, valves within -1…1; no NaN (7.7)."),
        (411, "Keep STATE to the period that HELLO asks for; 0 is every scan (7.7)."),
        (101, "Answer COMMAND with ACKNOWLEDGEMENT: its command_id and a reason (6.2, 7.3)."),
        (401, "Answer each request exactly once (6.2)."),
        (102, "Drop what has another magic, without any effect (3.5)."),
        (103, "Drop what is shorter than its header or its payload_bytes say (3.5)."),
        (107, "Drop what is longer than its payload_bytes say, or than its kind is (3.5)."),
        (109, "Check the CRC over bytes 0…11 and 16…end of every datagram (3.2)."),
        (118, "Drop kinds that are not in the table of 3.8."),
        (119, "Drop a payload that has not exactly the length of its kind (3.9)."),
        (116, "Drop datagrams with a critical flag (bits 8…15) that you do not know (3.4)."),
        (117, "Ignore optional flags (bits 0…7) that you do not know (3.4)."),
        (121, "Check integers against their range, enumerations against their table (3.5)."),
        (220, "Drop kinds that only a controller sends (3.5)."),
        (224, "End a session after link_timeout_ms of silence, with BYE LINK_TIMEOUT (5.4)."),
        (216, "Answer a datagram of a session that does not exist with BYE UNKNOWN_SESSION, rationed (4.4)."),
        (221, "End the session when BYE comes; never answer it (4.9)."),
        (211, "Refuse a second client with BYE SESSION_OCCUPIED, rationed (4.5, 8)."),
        (213, "Give a client that restarts at the same address a new session (4.5)."),
        (217, "Drop what is not of the open session (3.5)."),
        (218, "Drop what comes from another address or port than HELLO did (3.5)."),
        (301, "Use a datagram only if its sequence is newer than all before it (5.2; annex B has it)."),
        (302, "Drop late datagrams (5.2)."),
        (307, "Compare sequence numbers modulo 2^32 (1.9)."),
        (310, "Count skipped numbers as lost, and take late ones off that count again (5.2)."),
        (313, "Compute the age of every datagram, and drop what is older than max_age_ms (5.3)."),
        (402, "Remember the last 256 answers by command_id, and repeat them for a repeated request (6.3)."),
        (404, "Answer an id that comes again with another payload with REPEATED_COMMAND_ID (6.5)."),
        (405, "Answer an id below the newest with OVERTAKEN, and do nothing (6.4)."),
        (123, "Answer a command that is not in the table with UNKNOWN_COMMAND (3.6)."),
        (801, "Write the axes group's table of states, the row DISABLED first (7.3): DISABLE."),
        (803, "The row DISABLED: RESET (7.3)."),
        (
            808,
            "Answer a reference in DISABLED with DISABLED (7.3); judge the state before the content (6.10).",
        ),
        (507, "Latch EMERGENCY_STOP (7.4)."),
        (509, "Leave it by EMERGENCY_RELEASE, then RESET, and not otherwise (7.4)."),
        (415, "Judge stops before all that waits, whatever the queue holds (6.12)."),
        (800, "ENABLE: from DISABLED to STANDBY (7.3)."),
        (811, "DISABLE in STANDBY, and the rest of that row (7.3)."),
        (521, "Refuse a reference with NaN or infinity with NOT_FINITE (3.7)."),
        (522, "Refuse a quaternion whose norm is off by more than 1e-3 (1.5)."),
        (525, "Refuse a pose that cannot be reached, with value and limit (6.9)."),
        (527, "Move: to X_BT_ref in duration_s, then motion_done (6.7, 7.8)."),
        (528, "STOP in motion: ramp down to STANDBY (7.3)."),
        (530, "EMERGENCY_STOP in motion: centre the valves in the next scan (7.4)."),
        (529, "Stop when the link is lost, and resume nothing (7.5)."),
        (532, "REFERENCE_PATH: waypoints in order, at rest at each (6.8)."),
        (544, "START_STREAM: MOVING with the flag STREAMING, at rest until the first reference (12.2)."),
        (550, "Follow STREAMED_POSE without an answer, and name the newest in STATE (12.3)."),
        (572, "Silence: slow down, and centre the valves within silence_ms (12.8)."),
        (701, "With a key: refuse a HELLO that is not signed (11.2)."),
        (704, "Check the tag over all 16 bytes (11.5)."),
        (718, "Sign every datagram of the session (11.9)."),
        (722, "Without a key: answer a signed HELLO with KEY_NOT_CONFIGURED (11.2)."),
    )
)

COUPLER_STEPS = tuple(
    FirstHourStep(*row)
    for row in (
        (
            601,
            "Accept TCP, read a frame (MBAP: transaction, 0, length, unit; big-endian), answer function 3.",
        ),
        (602, "Repeat the transaction number of the request (1.2)."),
        (603, "Repeat the unit id, whatever it is (1.2)."),
        (604, "Put a request together that comes in pieces (1.3)."),
        (605, "Answer several requests that come in one piece, each and in order (1.3)."),
        (610, "Refuse function codes that are not in 2.1 with exception 1, the highest bit of the code set."),
        (612, "Refuse a quantity of 0 or above the largest of 2.1 with exception 3 (2.3)."),
        (617, "Refuse a request that is not exactly as long as it says with exception 3 (2.4)."),
        (638, "Refuse addresses outside the blocks of 3.1 with exception 2 (3.5)."),
        (634, "Serve the whole input image with function codes 3 and 4 (3.4)."),
        (635, "Serve the output image with function code 3 (3.4)."),
        (631, "The identification: seven words of text, the first character in the low byte (3.2)."),
        (632, "The status word (3.3)."),
        (633, "The lengths of the images, in bits (3.4)."),
        (611, "Every reading function code of 2.1."),
        (642, "Digital inputs, behind the analog ones (3.7)."),
        (607, "Close the connection on a frame of another protocol (1.4)."),
        (622, "Diagnostics, function code 8 (2.6)."),
        (651, "Function code 6: write an output word, and repeat the request (2.7)."),
        (652, "Function code 16 (2.7)."),
        (655, "Function code 23: write, then read (2.8)."),
        (653, "Function code 5, digital outputs (2.5, 2.7)."),
        (654, "Function code 15 (2.7)."),
        (657, "Change nothing when a request is refused, not in part either (2.9)."),
        (661, "The owner of the outputs: refuse other masters with exception 6 (4.2)."),
        (664, "An owner that has hung up owns nothing (4.3)."),
        (671, "The watchdog's time (5.1)."),
        (674, "Arm it with the first write; expiry sets status bit 15 (5.2, 5.4)."),
        (683, "After expiry refuse every access to the image with exception 4 (5.4)."),
        (686, "Zero all outputs at expiry (5.4)."),
        (687, "The two reset words (5.5)."),
    )
)
# fmt: on
