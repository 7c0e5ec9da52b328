"""Events that the sessions of the reference link hand to their shells."""

from typing import NamedTuple

from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Request, State, StreamedPose, StreamRefused, Welcome


class SessionOpened(NamedTuple):
    """Server: a client was welcomed."""

    session: int
    source: object


class SessionClosed(NamedTuple):
    """Server: the session ended, and why."""

    session: int
    reason: Reason


class RequestReceived(NamedTuple):
    """Server: a request to execute, handed over once; every one is to be acknowledged."""

    message: Request


class StreamedPoseReceived(NamedTuple):
    """Server: a streamed reference to judge; on the controller's clock.

    As far as the least transit tells: ``left_ns``, when it left the client, and ``measured_ns``, the instant
    of the measurement behind it.
    """

    message: StreamedPose
    left_ns: int
    measured_ns: int


class StreamRefusedReceived(NamedTuple):
    """Client: the controller has refused a streamed reference."""

    refusal: StreamRefused


class DatagramDropped(NamedTuple):
    """Either side: a datagram was not used; ``cause`` is a dotted slug."""

    cause: str
    detail: str


class Connected(NamedTuple):
    """Client: the session is open."""

    session: int
    welcome: Welcome


class ConnectionDelayed(NamedTuple):
    """Client: the controller refused for now (another client is connected); the client keeps asking."""

    reason: Reason


class AcknowledgementReceived(NamedTuple):
    """Client: the one answer to a submitted request."""

    acknowledgement: Acknowledgement


class StateReceived(NamedTuple):
    """Client: a fresh state of the controller."""

    state: State


class SessionLost(NamedTuple):
    """Client: the session ended or was refused. Whether ``unanswered`` ids were executed is unknown."""

    reason: Reason
    unanswered: tuple[int, ...]


ServerEvent = SessionOpened | SessionClosed | RequestReceived | StreamedPoseReceived | DatagramDropped
ClientEvent = (
    Connected
    | ConnectionDelayed
    | AcknowledgementReceived
    | StateReceived
    | StreamRefusedReceived
    | SessionLost
    | DatagramDropped
)
