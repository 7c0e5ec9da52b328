"""Sans-IO sessions of the reference link: both ends and their events under one name."""

from protocol.channel import LinkStatistics
from protocol.client_session import ReferenceClient
from protocol.clock_offset import OffsetEstimate
from protocol.server_session import ReferenceServer
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    ConnectionDelayed,
    DatagramDropped,
    LinkLost,
    RequestReceived,
    ServerEvent,
    SessionClosed,
    SessionOpened,
    StateReceived,
    StreamedPoseReceived,
    StreamRefusedReceived,
)

__all__ = [
    "AcknowledgementReceived",
    "ClientEvent",
    "Connected",
    "ConnectionDelayed",
    "DatagramDropped",
    "LinkLost",
    "LinkStatistics",
    "OffsetEstimate",
    "ReferenceClient",
    "ReferenceServer",
    "RequestReceived",
    "ServerEvent",
    "SessionClosed",
    "SessionOpened",
    "StateReceived",
    "StreamRefusedReceived",
    "StreamedPoseReceived",
]
