"""MAVLink 2 as pymavlink speaks it (its ``common`` dialect), for the benches: pack and decode, signed or not.

Its CRC runs in Python or, where ``fastcrc`` is installed, in Rust; its signature is SHA-256 cut to 6 bytes
over a secret put in front, and its replay check a comparison of time stamps.
"""

import importlib.util
from typing import Any

from pymavlink.dialects.v20 import common

SECRET = bytes(range(32))
FAST_CRC = importlib.util.find_spec("fastcrc") is not None


def target_message() -> Any:
    """SET_POSITION_TARGET_LOCAL_NED: a position, a velocity and a yaw; 53 bytes of payload."""
    return common.MAVLink_set_position_target_local_ned_message(
        1000, 1, 1, 1, 0, 3.89, -0.12, 1.01, 0.1, 0.2, 0.3, 0.01, 0.02, 0.03, 0.5, 0.25
    )


def pose_message() -> Any:
    """ATT_POS_MOCAP: a quaternion, a position and their covariance; 120 bytes of payload."""
    return common.MAVLink_att_pos_mocap_message(
        1000, [0.5, -0.5, 0.5, -0.5], 3.89, -0.12, 1.01, [0.01 * n for n in range(1, 22)]
    )


class Link:
    """Both ends of one link; ``exchange`` packs a message and decodes it again."""

    def __init__(self, *, signed: bool) -> None:
        self._sender = common.MAVLink(None, srcSystem=1, srcComponent=1)
        self._receiver = common.MAVLink(None, srcSystem=1, srcComponent=1)
        if signed:
            for end in (self._sender, self._receiver):
                end.signing.secret_key = SECRET
                end.signing.sign_outgoing = True
                end.signing.timestamp = 1

    def exchange(self, message: Any) -> Any:
        """``message`` as the receiver decoded it; raises common.MAVError when it refuses it."""
        return self._receiver.decode(bytearray(message.pack(self._sender)))

    def size(self, message: Any) -> int:
        """Bytes on the wire."""
        return len(message.pack(self._sender))
