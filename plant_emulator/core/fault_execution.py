"""Orders carried out on the plant."""

from collections.abc import Callable
from typing import Any

import numpy as np

from plant_emulator.core.faults.kinds import MarkerCovered
from plant_emulator.core.faults.schedule import (
    FaultOrder,
    Injection,
    MendOrder,
    Order,
    OrderMessage,
    PlantAnswer,
)
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused

Cover = Callable[[MarkerCovered], object]


def true_points(plant: Plant) -> list[list[float]]:
    """Points (n, 3) of the true arm now in its true base, m: the base, each joint and hinge, the tool."""
    truth = plant.truth()
    X_BL = np.linalg.inv(truth.X_WB) @ plant.links()
    points = np.vstack([X_BL[:, :3, 3], truth.X_BT[:3, 3]])
    return [[round(float(value), 5) for value in point] for point in points]


def carry_out(message: OrderMessage, plant: Plant, cover: Cover, *, shows_truth: bool) -> PlantAnswer:
    """What the plant says to an order, which is carried out or refused. ``cover``: ``Scene.cover``."""
    outcome: dict[str, Any] = {}
    try:
        outcome["concerned"] = [one.as_dict() for one in obey(message.order, plant, cover)]
    except RequestRefused as refused:
        outcome = {"cause": refused.cause, "detail": str(refused)}
    return PlantAnswer(
        number=message.number,
        time_ns=plant.time_ns,
        active=[one.as_dict() for one in plant.faults.active],
        planned=[one.as_dict() for one in plant.faults.planned],
        arm_points_m=true_points(plant) if shows_truth else None,
        **outcome,
    )


def obey(order: Order, plant: Plant, cover: Cover) -> list[Injection]:
    """The faults that an order made or mended. Raises RequestRefused."""
    if isinstance(order, MendOrder):
        return plant.clear(order.number)
    if not isinstance(order, FaultOrder):
        return []  # a restart is for who holds the process
    if isinstance(order.fault, MarkerCovered):
        cover(order.fault)
    start_ns = plant.time_ns + round(1e9 * order.start_after_s)
    duration_ns = None if order.duration_s is None else max(round(1e9 * order.duration_s), 1)
    return [plant.inject(order.fault, start_ns, duration_ns)]
