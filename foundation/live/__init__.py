"""What a service records, shown while it happens: to viewers over a WebSocket, to Prometheus as text."""

from pydantic import Field

from foundation.configuration import Host, HostName, StrictModel
from foundation.rest.tokens import TokenSources


class LiveSettings(StrictModel):
    """Where the live view listens: for viewers (Foxglove's WebSocket protocol) and ``GET /metrics``.

    ``port``: 0: any free one. ``allowed_hosts``: names that it may be called by beside loopback and ``host``;
    ``allowed_origins``: of pages that may connect, such as ``https://viewer.example``; viewers that are
    programs of their own are pages in a file, which no site can claim to be. ``tokens``: who may look;
    compulsory where ``host`` is not loopback.
    """

    host: Host = "127.0.0.1"
    port: int = Field(0, ge=0, le=65535)
    allowed_hosts: tuple[HostName, ...] = ()
    allowed_origins: tuple[str, ...] = ("file://",)
    tokens: TokenSources = TokenSources()
