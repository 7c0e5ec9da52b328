"""What is looked at before the first case: is somebody there, is he free, and which optional parts has he."""

import time
from typing import NamedTuple

from conformance.master import Master
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.wire import Failed, NoAnswer
from protocol.errors import LinkLost
from protocol.faults import Reason
from protocol.reference_messages import CAPABILITY_PATHS, CAPABILITY_STREAMING, Hello, Welcome

LOOK_MS = 3000
_PAUSE_S = 0.2
_OFFERED = {OptionalPart.PATHS: CAPABILITY_PATHS, OptionalPart.STREAMING: CAPABILITY_STREAMING}
_REFUSED = {
    Reason.SESSION_OCCUPIED: ("link.session_occupied", "another client holds the session: end it first"),
    Reason.NOT_AUTHENTICATED: ("link.not_authenticated", "the controller demands authentication: give --key"),
    Reason.KEY_NOT_CONFIGURED: ("link.key_not_configured", "the controller has no key: leave --key out"),
    Reason.UNKNOWN_KEY: ("link.unknown_key", "the controller has another key than that of --key"),
}


class Findings(NamedTuple):
    """What a look has shown: the parts that are ``lacking``, each with the reason.

    ``expired``: the coupler's watchdog has, and this run may not reset it.
    """

    lacking: dict[OptionalPart, str]
    expired: bool = False


NOTHING_FOUND = Findings({})


def look_at_controller(peer: Peer) -> Findings:
    """Opens a session, leaves it again, and tells which capabilities were not granted.

    Raises LinkLost when nobody listens or answers, another client holds the session, or the keys do not fit.
    An answer that is wrong in any other way is left to the cases to judge.
    """
    where = f"{peer.address[0]}:{peer.address[1]}"
    offered = sum(_OFFERED.values()) | peer.required
    try:
        answer = peer.greeted(Hello(peer.nonce(), offered, 0, 100), LOOK_MS)
        if isinstance(answer, Welcome):
            peer.alive("the first heartbeat")
    except (NoAnswer, ConnectionRefusedError) as error:
        if peer.welcome is not None:
            return NOTHING_FOUND
        raise LinkLost("link.unreachable", f"{where}: nobody listens on this UDP port") from error
    except Failed:
        return NOTHING_FOUND
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
    finally:
        peer.close()
    if answer is None:
        hint = " (one that does not know clause 11 drops what is signed)" if peer.link_key else ""
        raise LinkLost("link.no_answer", f"{where}: HELLO is not answered within {LOOK_MS} ms{hint}")
    if isinstance(answer, Welcome):
        granted = answer.capabilities
        return Findings(
            {part: f"{part.name} is not granted" for part, bit in _OFFERED.items() if not granted & bit}
        )
    if answer in _REFUSED:
        cause, why = _REFUSED[answer]
        raise LinkLost(cause, f"{where}: {why}")
    return NOTHING_FOUND


def look_at_coupler(host: str, port: int, unit: int, *, outputs: bool) -> Findings:
    """Reads the status, and with ``outputs`` resets a watchdog that was left expired.

    Raises LinkLost when nobody accepts the connection or answers, or, with ``outputs``, when another master
    owns them. A wrong answer is left to the cases to judge.
    """
    where = f"{host}:{port}"
    try:
        master = Master(host, port, unit, outputs=outputs)
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: no connection: {error.strerror or error}") from error
    try:
        if outputs:
            _free(master, where)
            if master.expired:
                master.reset()
            return NOTHING_FOUND
        return Findings({}, master.expired)
    except NoAnswer as error:
        raise LinkLost("link.no_answer", f"{where}: connected, but {error}") from error
    except OSError as error:
        raise LinkLost("link.unreachable", f"{where}: {error.strerror or error}") from error
    except Failed:
        return NOTHING_FOUND
    finally:
        master.hang_up()


def _free(master: Master, where: str) -> None:
    """Returns once nobody owns the outputs; raises LinkLost when somebody still does after LOOK_MS."""
    until_s = time.monotonic() + LOOK_MS / 1e3
    while master.owned_by_another():
        if time.monotonic() > until_s:
            why = "another master owns the outputs: stop it, or leave --outputs out"
            raise LinkLost("link.session_occupied", f"{where}: {why}")
        time.sleep(_PAUSE_S)
