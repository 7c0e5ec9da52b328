"""The Lua dissector in tshark, where that is installed."""

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from conformance.wire import with_bit_flipped, with_number
from dissector import SCRIPT
from protocol.authentication import LinkKey
from protocol.datagram import encode
from tests.dissector.captures import write_pcap
from tests.protocol.sample_messages import HEADER as SAMPLE_HEADER
from tests.protocol.sample_messages import MESSAGES
from tests.support.pages import commands_of
from tests.support.paths import ROOT

TSHARK = shutil.which("tshark")
pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed: apt-get install tshark")
KEY = LinkKey(bytes(range(32)))
DATAGRAMS = [encode(message, SAMPLE_HEADER) for message in MESSAGES]


def dissected(path: Path, *arguments: str) -> list[dict[str, Any]]:
    """What tshark says of every packet: lists of values by field name."""
    assert TSHARK is not None
    command = [TSHARK, "-X", f"lua_script:{SCRIPT}", "-r", str(path), "-T", "json", "--no-duplicate-keys"]
    run = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=60, check=True)
    assert "lua" not in run.stderr.lower() or "error" not in run.stderr.lower(), run.stderr
    return [packet["_source"]["layers"] for packet in json.loads(run.stdout)]


def found(layer: Any, name: str) -> list[str]:
    """All values of a field, however deep."""
    if isinstance(layer, list):
        return [value for each in layer for value in found(each, name)]
    if not isinstance(layer, dict):
        return []
    values = []
    for key, value in layer.items():
        if key == name and not isinstance(value, dict):
            values += value if isinstance(value, list) else [value]
        else:
            values += found(value, name)
    return values


@pytest.mark.parametrize("port", [47_000, 40_123])
def test_tshark_reads_what_was_encoded(tmp_path: Path, port: int) -> None:
    path = tmp_path / "all.pcap"
    write_pcap(path, DATAGRAMS, port=port)
    packets = dissected(path)
    assert len(packets) == len(MESSAGES)
    for number, (packet, message) in enumerate(zip(packets, MESSAGES, strict=True), 1):
        assert found(packet, "lrlk.kind") == [str(number)]
        assert int(found(packet, "lrlk.sequence")[0]) == SAMPLE_HEADER.sequence
        assert int(found(packet, "lrlk.session")[0], 16) == SAMPLE_HEADER.session
        assert "lrlk.bad_crc" not in json.dumps(packet)
        assert "lrlk.malformed" not in json.dumps(packet)
        kind = re.sub(r"(?<!^)(?=[A-Z])", "_", type(message).__name__).lower()
        for name, value in message._asdict().items():
            shown = found(packet, f"lrlk.{kind}.{name}")
            flat = _numbers(value)
            numbers = [float(int(v, 0)) if re.fullmatch(r"0x[0-9a-f]+|\d+", v) else float(v) for v in shown]
            assert numbers[: len(flat)] == pytest.approx(flat, rel=1e-12), f"{kind}.{name}"


def _numbers(value: Any) -> list[float]:
    if isinstance(value, tuple):
        return [number for part in value for number in _numbers(part)]
    return [float(value)]


def test_tshark_tells_of_bad_crc_and_of_what_is_malformed(tmp_path: Path) -> None:
    path = tmp_path / "bad.pcap"
    stop = DATAGRAMS[6]
    write_pcap(
        path, [stop, with_bit_flipped(stop, 400), with_number(stop, 4, "B", 9), stop[:30], stop + b"\0" * 8]
    )
    packets = [json.dumps(packet) for packet in dissected(path)]
    assert ["lrlk.bad_crc" in packet for packet in packets] == [False, True, False, False, True]
    assert ["lrlk.malformed" in packet for packet in packets] == [False, False, True, True, True]


def test_the_lines_of_the_page_show_a_capture(tmp_path: Path) -> None:
    path = tmp_path / "all.pcap"
    write_pcap(path, DATAGRAMS)
    whole, fields = [line for line in commands_of("protocol.md", "Annex D") if line.startswith("tshark ")]

    def said(line: str) -> str:
        arguments = shlex.split(line.replace("docs/protocol/sample.pcap", str(path)))
        return subprocess.run(
            arguments, capture_output=True, text=True, cwd=ROOT, timeout=60, check=True
        ).stdout

    text = said(whole)
    for message in MESSAGES:
        assert re.sub(r"(?<!^)(?=[A-Z])", "_", type(message).__name__).upper() in text
    assert "code: STOP" in text
    sequence, joints = said(fields).split()
    assert int(sequence) == SAMPLE_HEADER.sequence
    assert [float(each) for each in joints.split(",")] == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]


def test_tshark_filters_by_our_fields(tmp_path: Path) -> None:
    path = tmp_path / "all.pcap"
    write_pcap(path, DATAGRAMS)
    assert len(dissected(path, "-Y", "lrlk.command.code == 3")) == 1
    assert len(dissected(path, "-Y", "lrlk")) == len(DATAGRAMS)


def test_tshark_shows_the_trailer_of_signed_datagrams(tmp_path: Path) -> None:
    path = tmp_path / "signed.pcap"
    header = SAMPLE_HEADER._replace(sequence=SAMPLE_HEADER.sequence + (7 << 32))
    signed = [encode(message, header, KEY.of_hello()) for message in MESSAGES]
    write_pcap(path, [*signed, DATAGRAMS[6], signed[6][:-8]])
    *whole, plain, cut = dissected(path)
    for packet, data in zip(whole, signed, strict=True):
        assert "lrlk.bad_crc" not in json.dumps(packet)
        assert "lrlk.malformed" not in json.dumps(packet)
        assert found(packet, "lrlk.trailer.sequence_high") == ["7"]
        assert int(found(packet, "lrlk.trailer.key_id")[0], 16) == KEY.key_id
        assert found(packet, "lrlk.trailer.tag")[0].replace(":", "") == data[-16:].hex()
    said = info_column(path)
    assert all(line.endswith(" signed") for line in said[: len(signed)])
    assert "signed" not in said[len(signed)]
    assert found(plain, "lrlk.trailer.tag") == []
    assert "lrlk.malformed" in json.dumps(cut)
    assert len(dissected(path, "-Y", "lrlk.trailer.tag")) == len(signed)


def info_column(path: Path) -> list[str]:
    """The info column of every packet."""
    assert TSHARK is not None
    command = [TSHARK, "-X", f"lua_script:{SCRIPT}", "-r", str(path), "-T", "fields", "-e", "_ws.col.Info"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return run.stdout.splitlines()
