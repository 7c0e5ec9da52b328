"""Orders to break and mend the running plant, and what is told of its faults: data between API and plant.

The fault API is a process of its own (decision 0022). These models are all that crosses over, as JSON.
"""

from functools import cache
from typing import Annotated, Any, Literal, Union, get_args

from pydantic import Field, create_model

from foundation.configuration import StrictModel
from plant_emulator.core.faults.kinds import Fault, OwnFault

LONGEST_S = 3600.0
MOST_BYTES = 1 << 16  # of a message; 64 faults are a third of it


class FaultOrder(StrictModel):
    """A fault, ``start_after_s`` of simulated time from now, for ``duration_s`` (null: until cleared)."""

    fault: Annotated[Fault, Field(discriminator="kind")]
    start_after_s: Annotated[float, Field(ge=0.0, le=LONGEST_S)] = 0.0
    duration_s: Annotated[float, Field(gt=0.0, le=LONGEST_S)] | None = None


class MendOrder(StrictModel):
    """Mend the fault of this number, or every fault (null)."""

    number: int | None


class RestartOrder(StrictModel):
    """End the emulator in good order; who supervises it starts it anew, with the world as it was at first."""

    restart: Literal[True] = True


Order = FaultOrder | MendOrder | RestartOrder


class OrderMessage(StrictModel):
    """API → plant: the ``number``-th order."""

    number: int
    order: Order


class FaultState(StrictModel):
    """Simulated time (ns), and the faults in force and planned at that time, as ``Injection.as_dict``."""

    time_ns: int
    active: list[dict[str, Any]]
    planned: list[dict[str, Any]]


class OrderAnswer(StrictModel):
    """What became of the ``number``-th order: the faults it concerned, or why it is refused."""

    number: int
    concerned: tuple[dict[str, Any], ...] = ()
    cause: str = ""
    detail: str = ""


class PlantMessage(StrictModel):
    """Plant → API: the state now, after the order that is answered, if one is.

    ``arm_points_m``: as ``true_points`` has them, where the truth is shown.
    """

    state: FaultState
    arm_points_m: list[list[float]] | None = None
    answer: OrderAnswer | None = None


@cache  # one class for all who ask: pydantic takes no other's instances
def order_with(own: tuple[type[OwnFault], ...]) -> type[FaultOrder]:
    """An order that may also ask for the disturbances ``own`` of other packages."""
    if not own:
        return FaultOrder
    kinds: Any = Union[(*get_args(Fault), *own)]  # as many as there are
    every: Any = Annotated[kinds, Field(discriminator="kind")]
    made: type[FaultOrder] = create_model(
        "FaultOrder", __base__=FaultOrder, __doc__=FaultOrder.__doc__, fault=(every, ...)
    )
    return made


@cache
def message_with(own: tuple[type[OwnFault], ...]) -> type[OrderMessage]:
    """A message with such an order."""
    if not own:
        return OrderMessage
    order: Any = order_with(own) | MendOrder | RestartOrder
    made: type[OrderMessage] = create_model("OrderMessage", __base__=OrderMessage, order=(order, ...))
    return made
