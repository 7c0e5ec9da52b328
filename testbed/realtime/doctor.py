"""What `longreach doctor` finds out: whether this machine and this configuration can run the testbed."""

import importlib.metadata
import math
import os
import platform
import re
import secrets
import shutil
import socket
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from foundation.configuration import configuration_hash
from foundation.secret_source import read_key
from nominal_arm.description import NominalArm
from protocol.client_session import ReferenceClient
from protocol.errors import ConfigurationError
from protocol.faults import Reason
from protocol.session_events import Connected, ConnectionDelayed, SessionLost
from testbed.realtime.launch import PortUse
from testbed.realtime.limits import cores_of_container, least_memory
from vision_pc.config.vision import LinkSettings

Verdict = Literal["ok", "warning", "failed"]

WANTED_CORES = 2
WANTED_MEMORY_MB = 2048
WANTED_DISK_MB = 512
SLEEPS = 400
SLEEP_S = 0.001
PYTHONS = ((3, 11), (3, 12), (3, 13))  # the lock is resolved for the first and installs on all
PYTHONS_IN_WORDS = "Python 3.11, 3.12 or 3.13"
LATE_WARNING_US = 5000.0  # one cycle: a timer later than this at the 99th percentile will cost overruns


class HealthCheck(NamedTuple):
    """One line of the examination: what was looked at, the verdict, what was found, what to do about it."""

    name: str
    verdict: Verdict
    found: str
    advice: str = ""


def python_check() -> HealthCheck:
    """Whether this is a Python that the locked dependencies are for."""
    found = f"{platform.python_implementation()} {platform.python_version()}"
    good = sys.version_info[:2] in PYTHONS
    advice = "" if good else f"install {PYTHONS_IN_WORDS}; make clean setup"
    return HealthCheck("python", "ok" if good else "failed", found, advice)


def locked_versions(lock: Path) -> dict[str, str]:
    """Name → version of every package that the lock file pins."""
    pins = re.findall(r"^([A-Za-z0-9._-]+)==([^\s\\]+)", lock.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(pins)


def versions_check(lock: Path) -> HealthCheck:
    """Whether the installed packages are those of the lock file."""
    if not lock.is_file():
        return HealthCheck(
            "packages", "warning", f"no {lock.name} here to compare with", "run it in the repository"
        )
    pins = locked_versions(lock)
    wrong = []
    for name, version in pins.items():
        try:
            installed = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            installed = "missing"
        if installed != version:
            wrong.append(f"{name} {installed} instead of {version}")
    if wrong:
        return HealthCheck("packages", "failed", "; ".join(wrong), "make setup")
    return HealthCheck("packages", "ok", f"all {len(pins)} as locked")


def cores_check() -> HealthCheck:
    """How many cores this process may use, and how busy the machine is."""
    quota = cores_of_container()
    cores = min(len(os.sched_getaffinity(0)), quota or math.inf)
    load = os.getloadavg()[0]
    found = f"{cores:g} usable{' to this container' if cores == quota else ''}, load {load:.2f}"
    if cores < WANTED_CORES:
        return HealthCheck(
            "cores", "warning", found, f"{WANTED_CORES} are wanted for real time; use demo --lockstep"
        )
    if load > 0.5 * cores:
        return HealthCheck("cores", "warning", found, "other work is running: expect overruns")
    return HealthCheck("cores", "ok", found)


def memory_check() -> HealthCheck:
    """How much memory can be had: the least of machine, container and process."""
    limit = least_memory()
    available_mb = limit.bytes // 2**20
    good = available_mb >= WANTED_MEMORY_MB
    found = f"{available_mb} MB available to {limit.whose}"
    return HealthCheck("memory", "ok" if good else "warning", found, "" if good else limit.advice)


def disk_check(runs: Path) -> HealthCheck:
    """How much room there is for recordings."""
    place = next(parent for parent in (runs.absolute(), *runs.absolute().parents) if parent.exists())
    free_mb = shutil.disk_usage(place).free // 2**20
    found = f"{free_mb} MB free for {runs}"
    if not os.access(place, os.W_OK):
        return HealthCheck("disk", "failed", f"{place} is not writable", "name another directory with --out")
    good = free_mb >= WANTED_DISK_MB
    return HealthCheck("disk", "ok" if good else "failed", found, "" if good else "make room")


def timer_check() -> HealthCheck:
    """How late a sleep of one millisecond ends."""
    late_us = []
    for _ in range(SLEEPS):
        due = time.monotonic() + SLEEP_S
        time.sleep(SLEEP_S)
        late_us.append(1e6 * (time.monotonic() - due))
    cuts = statistics.quantiles(late_us, n=100)
    resolution_ns = 1e9 * time.clock_getres(time.CLOCK_MONOTONIC)
    found = (
        f"resolution {resolution_ns:.0f} ns; 1 ms sleeps end {cuts[49]:.0f}/{cuts[98]:.0f} µs late (p50/p99)"
    )
    good = cuts[98] < LATE_WARNING_US
    advice = "" if good else "expect overruns; demo --lockstep has none"
    return HealthCheck("timer", "ok" if good else "warning", found, advice)


def scheduling_check() -> HealthCheck:
    """Whether real-time scheduling can be had (it is not needed)."""
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return HealthCheck(
            "scheduling", "ok", "no real-time class; vision and renderer will run at low priority"
        )
    os.sched_setscheduler(0, before, parameters)
    return HealthCheck("scheduling", "ok", "real-time class SCHED_FIFO can be had")


def port_check(use: PortUse) -> HealthCheck:
    """Whether the port is free to be served."""
    if hindrance := use.hindrance():
        advice = "end what holds it, or use --free-ports"
        return HealthCheck(f"port {use.name}", "failed", f"{use.label}: {hindrance}", advice)
    return HealthCheck(f"port {use.name}", "ok", f"{use.label} is free")


def configuration_check(name: str, load: Callable[[], object]) -> HealthCheck:
    """Whether one configuration file can be loaded."""
    try:
        load()
    except ConfigurationError as error:
        return HealthCheck(f"configuration {name}", "failed", str(error), "correct the file")
    return HealthCheck(f"configuration {name}", "ok", "valid")


def engine_check() -> HealthCheck:
    """Whether containers could be used (they are not needed)."""
    tools = [tool for tool in ("docker", "docker-compose") if shutil.which(tool)]
    return HealthCheck(
        "containers", "ok", ", ".join(tools) + " found" if tools else "no engine found; not needed"
    )


def machine_checks(lock: Path, runs: Path) -> Iterator[HealthCheck]:
    """The checks that need no configuration, one by one."""
    yield python_check()
    yield versions_check(lock)
    yield cores_check()
    yield memory_check()
    yield disk_check(runs)
    yield timer_check()
    yield scheduling_check()
    yield engine_check()


_ANSWER_S = 0.5
_READ_S = 0.05


def arm_check(arm: NominalArm, link: LinkSettings) -> HealthCheck:
    """The arm's hash, and whether a controller that answers at the link's address has the same."""
    mine = configuration_hash(arm)
    found = f"{arm.name}: hash {mine:#018x}"
    answer = greeted(link, mine)
    where = f"{link.host}:{link.port}"
    if answer is None:
        return HealthCheck("arm", "ok", f"{found}; no controller at {where} to compare it with")
    if answer is Reason.WRONG_ARM:
        advice = "give both the same arm.yaml, or a PLC this hash; vision.link.any_arm=true does without"
        return HealthCheck(
            "arm", "warning" if link.any_arm else "failed", f"{found}; {where} has another", advice
        )
    if answer in (Reason.ACCEPTED, Reason.SESSION_OCCUPIED):  # who is occupied has compared the arm first
        return HealthCheck("arm", "ok", f"{found}; the controller at {where} has the same")
    why = answer.name.lower().replace("_", " ")
    return HealthCheck(
        "arm", "warning", f"{found}; {where} refuses a session: {why}", "see clause 4 of protocol.md"
    )


def greeted(link: LinkSettings, arm_hash: int) -> Reason | None:
    """What a controller answers to HELLO with ``arm_hash``; None when nobody answers. A session is closed."""
    client = ReferenceClient(
        secrets.randbits(64), arm_hash, link.state_period_ms, key=read_key(link.link_key)
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.settimeout(_READ_S)
        try:
            udp.connect((link.host, link.port))
            client.connect(time.monotonic_ns())
            deadline = time.monotonic() + _ANSWER_S
            answer = None
            while answer is None and time.monotonic() < deadline:
                answer = _exchange_datagrams(client, udp)
            client.disconnect(time.monotonic_ns())
            for datagram in client.outgoing():
                udp.send(datagram)
        except OSError:
            return None
    return answer


def _exchange_datagrams(client: ReferenceClient, udp: socket.socket) -> Reason | None:
    """Send what is due and read one datagram; the verdict, if it holds one."""
    client.tick(time.monotonic_ns())
    for datagram in client.outgoing(time.monotonic_ns()):
        udp.send(datagram)
    try:
        data = udp.recv(2048)
    except TimeoutError:
        return None
    for event in client.receive(data, time.monotonic_ns()):
        if isinstance(event, Connected):
            return Reason.ACCEPTED
        if isinstance(event, SessionLost | ConnectionDelayed):
            return event.reason
    return None
