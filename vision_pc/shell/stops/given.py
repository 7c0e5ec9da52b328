"""What the vision PC gives its door at the start."""

from typing import NamedTuple

from foundation.rest.access import Access
from protocol.authentication import LinkKey

MOST_BYTES = 1 << 16  # of a message between vision PC and door


class Given(NamedTuple):
    """``service``: the path of the socket behind the door; ``key``: of the reference link."""

    service: str
    access: Access
    key: LinkKey | None
