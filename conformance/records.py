"""Results on disk: JUnit for a build server, JSON for a program, a transcript of the bytes for a person."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from conformance.case import CaseOutcome, Result, Summary, verdict_of
from conformance.wire import Line
from protocol.datagram import decode
from protocol.datagram_layout import FLAG_AUTHENTICATED
from protocol.errors import DatagramRefused
from protocol.reference_messages import Message, UnusableRequest

SCHEMA = "longreach.conformance.results"
SCHEMA_VERSION = 1
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
        "profile": None if profile is None else sorted(part.value for part in profile.claims),
        "verdict": "ended" if ended is not None else summary.verdict.value,
        "ended": None if ended is None else {"cause": ended.cause, "message": str(ended)},
        "duration_s": round(summary.seconds, 3),
        "tester_late": summary.lateness._asdict(),
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
    for name, value in summary.lateness._asdict().items():
        ElementTree.SubElement(properties, "property", name=f"tester_late.{name}", value=str(value))
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
    return "\n".join(head + [_shown(line, says(line.data)) for line in lines]) + "\n"


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


def _shown(line: Line, what: str) -> str:
    arrow = "→" if line.direction == "send" else "←"
    rows = [line.data[i : i + _BYTES_A_LINE].hex() for i in range(0, len(line.data), _BYTES_A_LINE)]
    return "\n    ".join([f"{line.at_ms:9.2f} ms {arrow} {len(line.data)} bytes, {what}", *rows])
