"""Whether the controller drives the arm of arm.yaml: asked at HELLO, as the vision PC does."""

import secrets
import socket
import time

from foundation.configuration import configuration_hash
from foundation.secret_source import read_key
from nominal_arm.description import NominalArm
from protocol.client_session import ReferenceClient
from protocol.faults import Reason
from protocol.session_events import Connected, ConnectionDelayed, SessionLost
from testbed.realtime.doctor import HealthCheck
from vision_pc.config.vision import LinkSettings

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
                answer = _exchanged(client, udp)
            client.disconnect(time.monotonic_ns())
            for datagram in client.outgoing():
                udp.send(datagram)
        except OSError:
            return None
    return answer


def _exchanged(client: ReferenceClient, udp: socket.socket) -> Reason | None:
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
