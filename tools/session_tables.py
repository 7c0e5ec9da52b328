"""State tables of both ends of a session: printed in docs/protocol.md, played by test_session_tables."""

from typing import NamedTuple


class Row(NamedTuple):
    """In ``state``, after ``event``: the next state, and the datagrams that are sent."""

    state: str
    event: str
    then: str
    sends: str


SERVER_ROWS = (
    Row("CLOSED", "HELLO, nonce not used before, arm_hash 0 or its own", "CLOSED", "WELCOME"),
    Row(
        "CLOSED", "first datagram in the session of the newest WELCOME: HEARTBEAT", "OPEN", "HEARTBEAT_REPLY"
    ),
    Row("CLOSED", "the same, later than link_timeout_ms", "CLOSED", "BYE UNKNOWN_SESSION"),
    Row("CLOSED", "state period has passed since WELCOME", "CLOSED", "–"),
    Row("CLOSED", "HELLO, same source, same nonce", "CLOSED", "the same WELCOME"),
    Row("CLOSED", "HELLO, arm_hash of another arm", "CLOSED", "BYE WRONG_ARM"),
    Row("CLOSED", "HELLO, nonce of an earlier session", "CLOSED", "–"),
    Row("CLOSED", "datagram of another major version", "CLOSED", "BYE INCOMPATIBLE_VERSION"),
    Row("CLOSED", "BYE", "CLOSED", "–"),
    Row("CLOSED", "any other datagram", "CLOSED", "BYE UNKNOWN_SESSION"),
    Row("OPEN", "HELLO, same source, same nonce", "OPEN", "WELCOME"),
    Row("OPEN", "HELLO, same source, new nonce, sent later", "OPEN", "WELCOME"),
    Row(
        "OPEN",
        "first datagram in the session of that WELCOME: HEARTBEAT",
        "OPEN, new session",
        "HEARTBEAT_REPLY",
    ),
    Row("OPEN", "HELLO, same source, new nonce, sent earlier", "OPEN", "–"),
    Row("OPEN", "HELLO, arm_hash of another arm", "OPEN", "BYE WRONG_ARM"),
    Row("OPEN", "HELLO, another source", "OPEN", "BYE SESSION_OCCUPIED"),
    Row("OPEN", "datagram of another major version", "OPEN", "BYE INCOMPATIBLE_VERSION"),
    Row("OPEN", "HEARTBEAT", "OPEN", "HEARTBEAT_REPLY"),
    Row("OPEN", "request, id above all before", "OPEN", "ACKNOWLEDGEMENT after the decision"),
    Row("OPEN", "request again, decided", "OPEN", "the same ACKNOWLEDGEMENT"),
    Row("OPEN", "request again, not yet decided", "OPEN", "–"),
    Row("OPEN", "request, id used, content differs", "OPEN", "ACKNOWLEDGEMENT REPEATED_COMMAND_ID"),
    Row("OPEN", "request, id below the newest and not executed", "OPEN", "ACKNOWLEDGEMENT OVERTAKEN"),
    Row("OPEN", "state period has passed", "OPEN", "STATE"),
    Row("OPEN", "duplicate, late or stale datagram", "OPEN", "–"),
    Row("OPEN", "datagram of this session from another source", "OPEN", "–"),
    Row("OPEN", "datagram of another session, not BYE", "OPEN", "BYE UNKNOWN_SESSION"),
    Row("OPEN", "BYE", "CLOSED", "–"),
    Row("OPEN", "silence for more than link_timeout_ms", "CLOSED", "BYE LINK_TIMEOUT"),
    Row("OPEN", "the controller ends", "CLOSED", "BYE SHUTDOWN"),
)

CLIENT_ROWS = (
    Row("CLOSED", "asked to connect", "CONNECTING", "HELLO"),
    Row("CLOSED", "any datagram", "CLOSED", "–"),
    Row("CONNECTING", "HELLO period has passed", "CONNECTING", "HELLO, same nonce"),
    Row("CONNECTING", "HELLO period has passed after the tenth HELLO", "CONNECTING", "HELLO, new nonce"),
    Row("CONNECTING", "WELCOME with its nonce", "CONNECTED", "HEARTBEAT"),
    Row("CONNECTING", "WELCOME with another nonce", "CONNECTING", "–"),
    Row("CONNECTING", "BYE SESSION_OCCUPIED", "CONNECTING", "–"),
    Row("CONNECTING", "BYE with any other reason", "CLOSED", "–"),
    Row("CONNECTED", "heartbeat period has passed", "CONNECTED", "HEARTBEAT"),
    Row("CONNECTED", "request not answered within the resend time", "CONNECTED", "the request, same id"),
    Row("CONNECTED", "ACKNOWLEDGEMENT of an open request", "CONNECTED", "–"),
    Row("CONNECTED", "BYE of the session", "CLOSED", "–"),
    Row("CONNECTED", "silence for more than link_timeout_ms", "CLOSED", "BYE LINK_TIMEOUT"),
    Row("CONNECTED", "asked to disconnect", "CLOSED", "BYE SHUTDOWN"),
)

# What is added at the controller's end where a key is configured.
KEY_SERVER_ROWS = (
    Row("CLOSED", "HELLO, signed", "CLOSED", "WELCOME"),
    Row("CLOSED", "HELLO, not signed", "CLOSED", "BYE NOT_AUTHENTICATED"),
    Row("CLOSED", "HELLO, signed with another key", "CLOSED", "BYE UNKNOWN_KEY"),
    Row("CLOSED", "HELLO, with a wrong tag", "CLOSED", "BYE BAD_TAG"),
    Row("CLOSED", "first HEARTBEAT under the keys of WELCOME", "OPEN", "HEARTBEAT_REPLY"),
    Row("OPEN", "datagram not signed, of another key or with a wrong tag", "OPEN", "–"),
    Row("OPEN", "replay, or number behind the window", "OPEN", "–"),
    Row("OPEN", "BYE not signed", "OPEN", "–"),
)
