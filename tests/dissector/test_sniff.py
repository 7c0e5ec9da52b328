"""`longreach sniff`: captures read, datagrams spoken, unsound ones named with their cause."""

import json
import struct
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from conformance.wire import with_bit_flipped
from dissector.command import from_file, sniff
from protocol.authentication import LinkKey
from protocol.datagram import encode
from protocol.errors import ConfigurationError
from tests.dissector.captures import frame, write_pcap
from tests.support.paths import DOCS
from tools.sample_messages import HEADER, MESSAGES

DATAGRAMS = [encode(message, HEADER) for message in MESSAGES]
app = typer.Typer()
app.command()(sniff)


def test_every_kind_is_spoken_on_a_line_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "all.pcap"
    write_pcap(path, [*DATAGRAMS, b"something else"])
    result = CliRunner().invoke(app, ["--pcap", str(path)])
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert len(lines) == len(MESSAGES)
    for line, message in zip(lines, MESSAGES, strict=True):
        assert f" {type(message).__name__} seq={HEADER.sequence} " in line
    assert "10.0.0.1:5000 → 10.0.0.2:47000" in lines[0]
    assert lines[6].startswith("  0.006000 ")
    assert "command_id=43 code=STOP" in lines[6]
    assert "reason=JOINT_LIMIT value=1.75 limit=1.5" in lines[7]
    assert "X_BT_ref=[3.8935 -0.125 1.0083][0.5 -0.5 0.5 -0.5] duration_s=2.5" in lines[4]


def test_on_the_controller_s_port_unsound_datagrams_are_shown_with_their_cause(tmp_path: Path) -> None:
    path = tmp_path / "bad.pcap"
    write_pcap(path, [with_bit_flipped(DATAGRAMS[6], 400), b"something else", DATAGRAMS[6]])
    result = CliRunner().invoke(app, ["--pcap", str(path), "--port", "47000", "--json-lines"])
    told = [json.loads(line) for line in result.output.splitlines()]
    assert [each.get("refused") for each in told] == ["datagram.bad_crc", "datagram.too_short", None]
    assert told[2]["fields"] == {"command_id": 43, "code": "STOP"}
    assert told[2]["session"] == "1122334455667788"
    assert CliRunner().invoke(app, ["--pcap", str(path), "--port", "1"]).output == ""
    assert len(CliRunner().invoke(app, ["--pcap", str(path), "--count", "1"]).output.splitlines()) == 1


def test_only_whole_udp_over_ipv4_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "mixed.pcap"
    write_pcap(path, [DATAGRAMS[0]])
    head, good = path.read_bytes()[:24], path.read_bytes()[24:]
    raw = bytearray(frame(DATAGRAMS[0], 1, 2))
    raw[23] = 6  # TCP
    other = good[:8] + len(raw).to_bytes(4, "little") * 2 + bytes(raw)
    fragment = bytearray(frame(DATAGRAMS[0], 1, 2))
    fragment[20] = 0x20  # more fragments follow
    piece = good[:8] + len(fragment).to_bytes(4, "little") * 2 + bytes(fragment)
    path.write_bytes(head + other + piece + good + good[:-1])
    assert [packet.data for packet in from_file(path)] == [DATAGRAMS[0]]


def test_what_is_no_capture_is_refused_with_its_cause(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as missing:
        next(from_file(tmp_path / "none.pcap"))
    assert missing.value.cause == "sniff.unreadable"
    (tmp_path / "text").write_text("no capture at all, but long enough")
    with pytest.raises(ConfigurationError) as text:
        next(from_file(tmp_path / "text"))
    assert text.value.cause == "sniff.not_pcap"


def test_tags_are_noted_and_with_the_key_judged(tmp_path: Path) -> None:
    path, key_file = tmp_path / "signed.pcap", tmp_path / "key"
    key_file.write_text(bytes(range(32)).hex())
    key_file.chmod(0o600)
    key = LinkKey(bytes(range(32)))
    hello, welcome, beat, bye = (MESSAGES[i] for i in (0, 1, 2, 9))
    keys = key.of_client(welcome.client_nonce, HEADER.session, welcome.boot_id)
    datagrams = [
        encode(beat, HEADER, keys.sends),  # before its session was seen to open
        encode(hello, HEADER._replace(session=0), key.of_hello()),
        encode(welcome, HEADER, keys.receives),
        encode(beat, HEADER, keys.sends),
        encode(beat, HEADER, keys.receives),
        encode(bye, HEADER, keys.sends),
        encode(bye, HEADER, keys.receives),
        encode(bye, HEADER, key.of_hello()),
        encode(bye, HEADER, LinkKey(bytes(32)).of_hello()),
        DATAGRAMS[2],
    ]
    write_pcap(path, datagrams)
    judged = CliRunner().invoke(app, ["--pcap", str(path), "--key", str(key_file), "--json-lines"])
    told = [json.loads(line) for line in judged.output.splitlines()]
    assert [each.get("tag") or each.get("refused") for each in told] == [
        "not judged", "right", "right", "right", "authentication.bad_tag", "right", "right",
        "authentication.bad_tag", "authentication.unknown_key", None,
    ]  # fmt: skip
    unjudged = CliRunner().invoke(app, ["--pcap", str(path)]).output.splitlines()
    assert [" tag=not-judged " in line for line in unjudged] == [True] * 9 + [False]


def test_what_is_written_is_read_again_and_never_overwritten(tmp_path: Path) -> None:
    path, out = tmp_path / "all.pcap", tmp_path / "again.pcap"
    write_pcap(path, DATAGRAMS)
    assert CliRunner().invoke(app, ["--pcap", str(path), "--out", str(out)]).exit_code == 0
    assert list(from_file(out)) == list(from_file(path))
    refused = CliRunner().invoke(app, ["--pcap", str(path), "--out", str(out)])
    assert isinstance(refused.exception, ConfigurationError)
    assert refused.exception.cause == "sniff.not_written"


def test_the_sample_holds_a_session_from_hello_to_bye() -> None:
    printed = CliRunner().invoke(app, ["--pcap", str(DOCS / "protocol" / "sample.pcap")]).output
    assert " refused: " not in printed
    kinds = [line.split(" seq=")[0].rpartition(" ")[2] for line in printed.splitlines()]
    assert (kinds[0], kinds[-1]) == ("Hello", "Bye")
    assert {"Welcome", "Command", "Acknowledgement", "ReferencePose", "State"} <= set(kinds)


@pytest.mark.parametrize(
    ("link", "head"),
    [
        (113, struct.pack(">HHH8sH", 0, 1, 6, bytes(8), 0x0800)),
        (276, struct.pack(">HHIHBB8s", 0x0800, 0, 2, 1, 0, 6, bytes(8))),
        (228, b""),
    ],
)
def test_captures_of_all_interfaces_are_read_as_those_of_one(tmp_path: Path, link: int, head: bytes) -> None:
    path = tmp_path / "any.pcap"
    write_pcap(path, [DATAGRAMS[0]])
    content = path.read_bytes()
    packet = head + content[40 + 14 :]  # without the Ethernet frame
    sizes = content[24:32] + struct.pack("<2I", len(packet), len(packet))
    path.write_bytes(content[:20] + struct.pack("<I", link) + sizes + packet)
    assert [each.data for each in from_file(path)] == [DATAGRAMS[0]]
    path.write_bytes(content[:20] + struct.pack("<I", 147) + content[24:])
    with pytest.raises(ConfigurationError, match="link type 147 is not known here, 0, 1, 101, 113, 228, 276"):
        list(from_file(path))
