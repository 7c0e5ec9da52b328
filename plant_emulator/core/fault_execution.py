"""Orders carried out on the plant."""

from collections.abc import Callable

import numpy as np

from plant_emulator.core.faults.kinds import MarkerCovered
from plant_emulator.core.faults.schedule import (
    FaultState,
    Injection,
    MendOrder,
    Order,
    OrderAnswer,
    OrderMessage,
    PlantMessage,
    RestartOrder,
)
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused

Cover = Callable[[MarkerCovered], object]


def fault_state(plant: Plant) -> FaultState:
    """The plant's faults now."""
    active, planned = (
        [one.as_dict() for one in some] for some in (plant.faults.active, plant.faults.planned)
    )
    return FaultState.model_construct(time_ns=plant.time_ns, active=active, planned=planned)


def true_points(plant: Plant) -> list[list[float]]:
    """Points (n, 3) of the true arm now in its true base, m: the base, each joint and hinge, the tool."""
    truth = plant.truth()
    X_BL = np.linalg.inv(truth.X_WB) @ plant.links()
    points = np.vstack([X_BL[:, :3, 3], truth.X_BT[:3, 3]])
    return [[round(float(value), 5) for value in point] for point in points]


def carry_out(message: OrderMessage, plant: Plant, cover: Cover) -> PlantMessage:
    """What the plant says to an order, which is carried out or refused. ``cover``: ``Scene.cover``."""
    try:
        concerned = obey(message.order, plant, cover)
    except RequestRefused as refused:
        answer = OrderAnswer(number=message.number, cause=refused.cause, detail=str(refused))
    else:
        answer = OrderAnswer(number=message.number, concerned=tuple(one.as_dict() for one in concerned))
    return PlantMessage(state=fault_state(plant), answer=answer)


def obey(order: Order, plant: Plant, cover: Cover) -> list[Injection]:
    """The faults that an order made or mended. Raises RequestRefused."""
    if isinstance(order, RestartOrder):
        return []  # by who holds the process
    if isinstance(order, MendOrder):
        if order.number is not None:
            return [plant.clear(order.number)]
        mended = list(plant.faults.all())
        plant.clear_faults()
        return mended
    if isinstance(order.fault, MarkerCovered):
        cover(order.fault)
    start_ns = plant.time_ns + round(1e9 * order.start_after_s)
    duration_ns = None if order.duration_s is None else max(round(1e9 * order.duration_s), 1)
    return [plant.inject(order.fault, start_ns, duration_ns)]
