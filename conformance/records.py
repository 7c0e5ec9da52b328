"""Results on disk: JUnit for a build server, JSON for a program, a transcript of the bytes for a person."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from conformance.case import CaseOutcome
from conformance.runner import Result, Summary
from conformance.wire import Line
from protocol.datagram import decode
from protocol.datagram_layout import FLAG_AUTHENTICATED
from protocol.errors import DatagramRefused

_BYTES_A_LINE = 32
_MBAP_BYTES = 7


def write_records(summary: Summary, directory: Path) -> None:
    """Writes ``junit.xml``, ``results.json`` and ``transcripts/NUMBER.txt`` into ``directory``."""
    transcripts = directory / "transcripts"
    transcripts.mkdir(parents=True, exist_ok=True)
    (directory / "junit.xml").write_bytes(junit(summary))
    (directory / "results.json").write_text(json.dumps(as_json(summary), indent=1) + "\n")
    for result in summary.results:
        (transcripts / f"{result.case.number}.txt").write_text(transcript(result, summary.suite))


def as_json(summary: Summary) -> dict[str, Any]:
    """The summary as plain data."""
    return {
        "suite": summary.suite,
        "host": summary.host,
        "port": summary.port,
        **{outcome.value: summary.count(outcome) for outcome in CaseOutcome},
        "cases": [
            {
                "number": result.case.number,
                "clause": result.case.clause,
                "title": result.case.title,
                "outcome": result.outcome.value,
                "detail": result.detail,
                "duration_s": round(result.seconds, 3),
            }
            for result in summary.results
        ],
    }


def junit(summary: Summary) -> bytes:
    """The summary as JUnit XML; an unsupported case is a skipped one."""
    suite = ElementTree.Element(
        "testsuite",
        name=summary.suite,
        tests=str(len(summary.results)),
        failures=str(summary.count(CaseOutcome.FAIL)),
        skipped=str(summary.count(CaseOutcome.UNSUPPORTED)),
        time=f"{sum(result.seconds for result in summary.results):.3f}",
    )
    for result in summary.results:
        entry = ElementTree.SubElement(
            suite,
            "testcase",
            classname=f"clause {result.case.clause}",
            name=f"{result.case.number} {result.case.title}",
            time=f"{result.seconds:.3f}",
        )
        if result.outcome is not CaseOutcome.PASS:
            tag = "failure" if result.outcome is CaseOutcome.FAIL else "skipped"
            ElementTree.SubElement(entry, tag, message=result.detail)
    document: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return document


def transcript(result: Result, suite: str) -> str:
    """Every datagram or frame of a case: when, which way, what it says, and its bytes."""
    case = result.case
    says = _modbus if suite == "coupler" else _datagram
    head = [
        f"{case.number} (clause {case.clause}) {case.title}",
        f"{result.outcome.value} {result.detail}",
        "",
    ]
    return "\n".join(head + [_shown(line, says(line.data)) for line in result.transcript]) + "\n"


def _datagram(data: bytes) -> str:
    try:
        header, message = decode(data)
    except DatagramRefused as error:
        return error.cause
    signed = " signed" if header.flags & FLAG_AUTHENTICATED else ""
    return f"{type(message).__name__} sequence {header.sequence} session {header.session:x}{signed}"


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
