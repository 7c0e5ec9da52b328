"""Results on disk: JUnit for a build server, JSON for a program, a transcript of the bytes for a person."""

import json
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from conformance.case import CaseOutcome, Result, Summary, verdict_of
from conformance.wire import Line
from protocol.datagram import decode
from protocol.datagram_layout import FLAG_AUTHENTICATED
from protocol.errors import DatagramRefused
from protocol.reference_messages import Message, UnusableRequest


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
        (590, "Send STATE at the granted period, sampled in one scan, with cycle and time_ns (7.7, 3.9)."),
        (231, "Before the client's first datagram in a session send WELCOME alone (4.2)."),
        (237, "Send a source that has not proved to hear at most three times its bytes (4.11)."),
        (411, "Keep STATE to the period that HELLO asks for; 0 is every scan (7.7)."),
        (101, "Answer COMMAND with ACKNOWLEDGEMENT: its command_id and a reason (6.2, 7.3)."),
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
        (433, "Answer an id that comes again with another payload with REPEATED_COMMAND_ID (6.5)."),
        (434, "Answer an id below the newest with OVERTAKEN, and do nothing (6.4)."),
        (432, "Answer a command that is not in the table with UNKNOWN_COMMAND (3.6)."),
        (801, "Write the axes group's table of states, the row DISABLED first (7.3): DISABLE."),
        (803, "The row DISABLED: RESET (7.3)."),
        (
            808,
            "Answer a reference in DISABLED with DISABLED (7.3); judge the state before the content (6.10).",
        ),
        (507, "Latch EMERGENCY_STOP (7.4)."),
        (509, "Leave it by EMERGENCY_RELEASE, then RESET, and not otherwise (7.4)."),
        (415, "Judge stops before all that waits, whatever the queue holds (6.12)."),
        (423, "Judge a stop though its session ends in the same scan (6.12)."),
        (208, "Answer a repeated HELLO (same source, same nonce) with the same WELCOME again (4.6)."),
        (401, "Answer each request exactly once (6.2)."),
        (894, "Number every datagram you send one by one, WELCOME first (5.1)."),
        (897, "Fill STATE: poses with unit quaternions, joints, valves within -1…1; no NaN (7.7)."),
        (800, "ENABLE: from DISABLED to STANDBY (7.3)."),
        (811, "DISABLE in STANDBY, and the rest of that row (7.3)."),
        (521, "Refuse a reference with NaN or infinity with NOT_FINITE (3.7)."),
        (441, "Refuse a quaternion whose norm is off by more than 1e-3 (1.5)."),
        (525, "Refuse a pose that cannot be reached, with value and limit (6.9)."),
        (527, "Move: to X_BT_ref in duration_s, then motion_done (6.7, 7.8)."),
        (570, "STOP in motion: ramp down to STANDBY (7.3)."),
        (571, "EMERGENCY_STOP in motion: centre the valves in the next scan (7.4)."),
        (529, "Stop when the link is lost, and resume nothing (7.5)."),
        (534, "Stop and latch when BYE comes in motion (7.5)."),
        (535, "The same when the client restarts in place (7.5)."),
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
        (602, "Repeat the transaction number and the unit id of the request (1.2)."),
        (604, "Put pieces together; answer several requests of one piece each, in order (1.3)."),
        (610, "Refuse function codes that are not in 2.1 with exception 1, the highest bit of the code set."),
        (612, "Refuse a quantity of 0 or above the largest of 2.1 with exception 3 (2.3)."),
        (617, "Refuse a request that is not exactly as long as it says with exception 3 (2.4)."),
        (638, "Refuse addresses outside the blocks of 3.1 with exception 2 (3.5)."),
        (634, "Serve the images with function codes 1 to 4, and the lengths in bits (3.4)."),
        (631, "The identification: seven words of text, the first character in the low byte (3.2)."),
        (632, "The status word (3.3)."),
        (642, "Digital inputs, behind the analog ones (3.7)."),
        (607, "Close the connection on a frame of another protocol (1.4)."),
        (622, "Diagnostics, function code 8 (2.6)."),
        (651, "Function codes 6 and 16: write output words (2.7)."),
        (655, "Function code 23: write, then read (2.8)."),
        (653, "Function codes 5 and 15, digital outputs (2.5, 2.7)."),
        (657, "Change nothing when a request is refused, not in part either (2.9)."),
        (661, "The owner of the outputs: refuse other masters with exception 6 (4.2)."),
        (664, "An owner that has hung up owns nothing (4.3)."),
        (671, "The watchdog's time (5.1)."),
        (675, "Arm it with the first write; expiry sets status bit 15 (5.2, 5.4)."),
        (683, "After expiry refuse every access to the image with exception 4 (5.4)."),
        (686, "Zero all outputs at expiry (5.4)."),
        (687, "The two reset words (5.5)."),
    )
)
# fmt: on


SCHEMA = "longreach.conformance.results"
SCHEMA_VERSION = 2
_BYTES_A_LINE = 32
_MBAP_BYTES = 7
_JUNIT_TAGS = {
    CaseOutcome.FAIL: "failure",
    CaseOutcome.UNSUPPORTED: "skipped",
    CaseOutcome.FLAKY: "flakyFailure",
}


def write_records(summary: Summary, directory: Path) -> None:
    """Writes ``junit.xml``, ``results.json`` and a transcript of every asking into ``directory``.

    ``transcripts/NUMBER.txt`` is the last asking of a case; where the first one failed it is
    ``transcripts/NUMBER.first.txt``.
    """
    transcripts = directory / "transcripts"
    transcripts.mkdir(parents=True, exist_ok=True)
    (directory / "junit.xml").write_bytes(junit(summary))
    (directory / "results.json").write_text(json.dumps(as_json(summary), indent=1) + "\n")
    for result in summary.results:
        (transcripts / f"{result.case.number}.txt").write_text(transcript(result, summary.suite))
        if len(result.attempts) > 1:
            first = result._replace(attempts=result.attempts[:1])
            (transcripts / f"{result.case.number}.first.txt").write_text(transcript(first, summary.suite))


def as_json(summary: Summary) -> dict[str, Any]:
    """The summary as plain data, as docs/conformance.md describes it."""
    profile, ended = summary.profile, summary.ended
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "suite": summary.suite,
        "host": summary.host,
        "port": summary.port,
        "profile": None if profile is None else sorted(part.value for part in profile),
        "verdict": "ended" if ended is not None else summary.verdict.value,
        "ended": None if ended is None else {"cause": ended.cause, "message": str(ended)},
        "duration_s": round(summary.seconds, 3),
        "tester_late_max_ms": summary.late_ms,
        "counts": {outcome.value: summary.count(outcome) for outcome in CaseOutcome},
        "clauses": {
            clause: {
                "verdict": verdict_of([result.outcome for result in results]).value,
                "cases": [result.case.number for result in results],
            }
            for clause, results in summary.clauses.items()
        },
        "cases": [_case(result) for result in summary.results],
    }


def _case(result: Result) -> dict[str, Any]:
    return {
        "number": result.case.number,
        "clause": result.case.clause,
        "title": result.case.title,
        "outcome": result.outcome.value,
        "detail": result.detail,
        "duration_s": round(result.seconds, 3),
        "tester_late_max_ms": result.late_ms,
        "askings": [
            {"outcome": each.outcome.value, "detail": each.detail, "duration_s": round(each.seconds, 3)}
            for each in result.attempts
        ],
    }


def junit(summary: Summary) -> bytes:
    """The summary as JUnit XML: an unsupported case is skipped, a flaky one has a ``flakyFailure``.

    A run that broke off has an error of its own at the end.
    """
    ended = summary.ended
    suite = ElementTree.Element(
        "testsuite",
        name=summary.suite,
        tests=str(len(summary.results) + (ended is not None)),
        failures=str(summary.count(CaseOutcome.FAIL)),
        errors=str(int(ended is not None)),
        skipped=str(summary.count(CaseOutcome.UNSUPPORTED)),
        time=f"{summary.seconds:.3f}",
    )
    properties = ElementTree.SubElement(suite, "properties")
    ElementTree.SubElement(properties, "property", name="tester_late_max_ms", value=str(summary.late_ms))
    for result in summary.results:
        entry = ElementTree.SubElement(
            suite,
            "testcase",
            classname=f"clause {result.case.clause}",
            name=f"{result.case.number} {result.case.title}",
            time=f"{result.seconds:.3f}",
        )
        if result.outcome in _JUNIT_TAGS:
            ElementTree.SubElement(entry, _JUNIT_TAGS[result.outcome], message=result.detail)
    if ended is not None:
        entry = ElementTree.SubElement(suite, "testcase", classname="run", name="the whole run", time="0")
        ElementTree.SubElement(entry, "error", message=str(ended), type=ended.cause)
    document: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def transcript(result: Result, suite: str, newest: int | None = None) -> str:
    """Every datagram or frame of the last asking, or the ``newest``: when, which way, what, its bytes."""
    case = result.case
    says = _modbus if suite == "coupler" else _datagram
    head = [
        f"{case.number} (clause {case.clause}) {case.title}",
        f"{result.outcome.value} {result.detail}",
        "",
    ]
    lines = result.transcript
    if newest is not None and len(lines) > newest:
        head.append(f"… {len(lines) - newest} before these …")
        lines = lines[-newest:]
    return "\n".join(head + [_hex_lines(line, says(line.data)) for line in lines]) + "\n"


def _datagram(data: bytes) -> str:
    try:
        header, message = decode(data)
    except DatagramRefused as error:
        return f"{error.cause}: {error}"
    signed = " signed" if header.flags & FLAG_AUTHENTICATED else ""
    says = f"{type(message).__name__} sequence {header.sequence} session {header.session:x}{signed}"
    return f"{says}\n    {_fields(message)}"


def _fields(message: Message | UnusableRequest) -> str:
    """The fields of a message; numbers that are measured are left to the bytes below."""
    fields = message._asdict().items()
    shown = ((name, getattr(value, "name", value)) for name, value in fields)
    return (
        ", ".join(f"{name} {value}" for name, value in shown if not isinstance(value, tuple)) or "no fields"
    )


def _modbus(data: bytes) -> str:
    if len(data) < _MBAP_BYTES + 1:
        return "part of a frame"
    function = data[_MBAP_BYTES]
    what = f"function {function & 0x7F}" + (f" exception {data[-1]}" if function & 0x80 else "")
    return f"transaction {int.from_bytes(data[:2], 'big')} unit {data[6]} {what}"


def _hex_lines(line: Line, what: str) -> str:
    arrow = "→" if line.direction == "send" else "←"
    rows = [line.data[i : i + _BYTES_A_LINE].hex() for i in range(0, len(line.data), _BYTES_A_LINE)]
    return "\n    ".join([f"{line.at_ms:9.2f} ms {arrow} {len(line.data)} bytes, {what}", *rows])
