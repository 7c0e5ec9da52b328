"""Who keeps a place where there are only so many: whoever is served; the silence of strangers yields."""

from collections.abc import Collection
from typing import Protocol, TypeVar


class Guest(Protocol):
    """A connection. ``served``: how often it was; ``heard_ns``: when last, or when it came."""

    address: str
    served: int
    heard_ns: int


GuestT = TypeVar("GuestT", bound=Guest)


def who_yields(
    guests: Collection[GuestT], address: str, kept: GuestT | None, most: int, most_of_one: int
) -> GuestT | None:
    """The guest whose place a newcomer from ``address`` takes; None while a place is free.

    There are ``most`` places, and ``most_of_one`` for one address, whose own guests then yield. First go
    those never served, then those not heard for longest; ``kept`` never does.
    """
    rivals = [guest for guest in guests if guest.address == address]
    if len(rivals) < most_of_one:
        if len(guests) < most:
            return None
        rivals = list(guests)
    return min(
        (guest for guest in rivals if guest is not kept),
        key=lambda guest: (guest.served > 0, guest.heard_ns),
        default=None,
    )
