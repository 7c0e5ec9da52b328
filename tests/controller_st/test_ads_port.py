"""ADS from outside: Beckhoff's own client library, and sockets that misbehave."""

import contextlib
import io
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.scan_program import own_parts
from controller_st.ads_device import AdsDevice
from controller_st.ads_frames import AmsAddress, AmsFrame
from controller_st.ads_port import CLIENTS, AdsPort
from foundation.configuration import load
from foundation.event_log import EventLog
from nominal_arm.description import NominalArm
from protocol.errors import ConfigurationError
from structured_text.memory import MemoryView
from structured_text.program import CompiledProgram
from testbed.realtime.launch import free_port
from tests.controller_st.test_ads_device import COUNTER
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.realtime
CAUSES: list[str] = []
ADS_PORT = 48898  # AdsLib knows no other
# So its test has an address of its own: of two suites at a time, and beside a router, too.
OWN_HOST = f"127.{100 + os.getpid() % 100}.{os.getpid() // 256 % 256}.{1 + os.getpid() % 250}"


class Running(NamedTuple):
    """A program that counts its scans, its ADS port's address, and the processor time of each turn of it."""

    memory: MemoryView
    host: str
    port: int
    turns_s: list[float]


@contextlib.contextmanager
def running(
    log: EventLog, writable: bool = False, host: str = "127.0.0.1", number: int = 0
) -> Iterator[Running]:
    program = CompiledProgram({"counter.st": COUNTER})
    number = number or free_port()
    port = AdsPort(AdsDevice(program.memory, writable=writable), host, number, log)
    ended, turns_s = threading.Event(), []

    def cycle() -> None:
        while not ended.wait(0.002):
            program.run("MAIN")
            began_s = time.thread_time()
            port.serve(time.monotonic_ns())
            turns_s.append(time.thread_time() - began_s)
        port.close()

    thread = threading.Thread(target=cycle)
    thread.start()
    try:
        yield Running(program.memory, host, number, turns_s)
    finally:
        ended.set()
        thread.join(10.0)


@pytest.fixture
def log() -> EventLog:
    made = EventLog("controller", io.StringIO())
    made.listener = lambda event, level, fields: CAUSES.append(fields["cause"])
    CAUSES.clear()
    return made


@contextlib.contextmanager
def connected(host: str) -> Iterator[Any]:
    pyads = pytest.importorskip("pyads", reason="pyads is absent: make peers")
    net_id = f"{host}.1.1"
    pyads.add_route(net_id, host)
    with pyads.Connection(net_id, pyads.PORT_TC3PLC1, host) as client:
        client.set_timeout(5000)
        yield client
    pyads.delete_route(pyads.AmsAddr(net_id, pyads.PORT_TC3PLC1))


def test_beckhoffs_client_reads_writes_and_subscribes(log: EventLog) -> None:
    pyads = pytest.importorskip("pyads", reason="pyads is absent: make peers")
    with running(log, writable=True, host=OWN_HOST, number=ADS_PORT) as rig, connected(rig.host) as client:
        assert client.read_device_info()[0] == "Longreach ST PLC"
        assert client.read_state()[0] == pyads.ADSSTATE_RUN
        first = client.read_by_name("main.ncount")
        assert client.read_by_name("MAIN.nCount", pyads.PLCTYPE_UDINT) > first
        assert client.read_by_name("MAIN.afSix") == [0.5, 1.5, 2.5, 3.5, 4.5, 5.5]
        assert client.read_by_name("MAIN.stPart.aGrid[1,2]", pyads.PLCTYPE_INT) == 12
        names = {symbol.name for symbol in client.get_all_symbols()}
        assert {"MAIN", "MAIN.stPart", "MAIN.stPart.fGain", "MAIN.xOn"} <= names
        many = client.read_list_by_name(["MAIN.stPart.fGain", "MAIN.xOn", "MAIN.nCount"])
        assert (many["MAIN.stPart.fGain"], many["MAIN.xOn"]) == (2.5, True)
        client.write_by_name("MAIN.stPart.fGain", 7.25, pyads.PLCTYPE_LREAL)
        assert rig.memory.MAIN.stPart.fGain == 7.25
        with pytest.raises(pyads.ADSError, match="1808"):
            client.read_by_name("MAIN.nothing", pyads.PLCTYPE_UDINT)
        with pytest.raises(pyads.ADSError, match="1798"):
            client.write_by_name("MAIN.eKind", 77, pyads.PLCTYPE_INT)
        seen: list[int] = []
        attributes = pyads.NotificationAttrib(4, cycle_time=20)
        handles = client.add_device_notification(
            "MAIN.nCount",
            attributes,
            lambda got, _: seen.append(client.parse_notification(got, pyads.PLCTYPE_UDINT)[2]),
        )
        time.sleep(0.5)
        client.del_device_notification(*handles)
        assert len(seen) >= 5
        assert seen == sorted(set(seen))


def asked(command: int, data: bytes) -> bytes:
    return AmsFrame(AmsAddress(b"\1" * 6, 851), AmsAddress(b"\2" * 6, 9), command, 4, 0, 1, data).packed


@pytest.mark.parametrize(
    "wrong", [b"GET / HTTP/1.1\r\n\r\n", struct.pack("<HI", 0, 4_000_000_000), asked(4, b"")[:-2] + bytes(40)]
)
def test_what_is_no_ams_ends_the_connection_and_no_other(log: EventLog, wrong: bytes) -> None:
    with running(log) as rig, socket.create_connection((rig.host, rig.port), 5.0) as good:
        with socket.create_connection((rig.host, rig.port), 5.0) as bad:
            bad.sendall(wrong)
            with contextlib.suppress(ConnectionResetError):
                while bad.recv(4096):
                    pass
        good.sendall(asked(4, b""))
        assert len(good.recv(4096)) == 6 + 32 + 8


def test_who_floods_and_does_not_read_is_answered_as_far_as_a_turn_allows(log: EventLog) -> None:
    with running(log) as rig, contextlib.ExitStack() as held:
        flood = asked(9, struct.pack("<IIII", 0xF009, 0, 100, 10) + b"MAIN.afSix") * 200
        clients = [socket.create_connection((rig.host, rig.port), 5.0) for _ in range(CLIENTS)]
        for client in clients:
            held.enter_context(client)
            client.settimeout(0.01)
        rig.turns_s.clear()
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            for client in clients:
                with contextlib.suppress(TimeoutError):
                    client.send(flood)
        counted = rig.memory.MAIN.nCount
        assert counted > 50, "the scan goes on"
        assert np.percentile(rig.turns_s, 99) < 2e-3


def test_there_are_places_for_eight_and_who_leaves_makes_room(log: EventLog) -> None:
    with running(log) as rig:
        clients = [socket.create_connection((rig.host, rig.port), 5.0) for _ in range(CLIENTS)]
        clients[-1].sendall(asked(4, b""))
        assert clients[-1].recv(4096)
        with socket.create_connection((rig.host, rig.port), 5.0) as ninth:
            assert ninth.recv(1) == b""
        clients.pop().close()
        time.sleep(0.1)
        clients.append(socket.create_connection((rig.host, rig.port), 5.0))
        clients[-1].sendall(asked(4, b""))
        assert clients[-1].recv(4096)
        for client in clients:
            client.close()


def test_who_leaves_its_notifications_unread_is_ended(log: EventLog) -> None:
    with running(log) as rig, socket.create_connection((rig.host, rig.port), 5.0) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        watch = struct.pack("<IIIIII16x", 0x4040, 0, 80, 3, 0, 0)
        client.sendall(asked(6, watch) * 200)
        until_s = time.monotonic() + 20.0
        while "ads.not_read" not in CAUSES:
            assert time.monotonic() < until_s
            time.sleep(0.05)


def test_a_port_that_is_taken_is_refused_by_name(log: EventLog) -> None:
    with running(log) as rig, pytest.raises(ConfigurationError, match=rf"127\.0\.0\.1:{rig.port}"):
        AdsPort(AdsDevice(CompiledProgram({"counter.st": COUNTER}).memory), rig.host, rig.port, log)


def test_the_controller_in_python_shows_no_variables() -> None:
    arm = load(NominalArm, CONFIGS / "arm.yaml")
    config = load(ControllerConfig, CONFIGS / "controller.yaml", {"ads": {"port": ADS_PORT}})
    with pytest.raises(ConfigurationError, match="--controller st"):
        own_parts(arm, config, 1, None)
