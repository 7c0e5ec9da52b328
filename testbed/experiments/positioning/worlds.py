"""The worlds of the best mode's campaign by name: what each draws beside the task, and what is demanded.

``lab`` is the laboratory that the method was built in: servo valves that are known, a good camera. ``harder``
adds scale, drift, lens, print and play errors. ``real`` draws everything in which one machine differs from
the next; ``crane-real`` the same on the 10 m crane.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from foundation.configuration import merged
from testbed.experiments.positioning import axes, axes_of_sight
from testbed.experiments.positioning.axes import Axis
from testbed.lockstep.simulated_measurements import EyeCondition
from testbed.scenarios.settings import Settings

ARMS = ("plant", "plant_long_crane")


class Demands(NamedTuple):
    """What is asked of a world's rows; None: a figure is for information."""

    one_look: float | None = None
    two_looks: float | None = None
    open_loop: float | None = None
    median_mm: float | None = None
    q95_mm: float | None = None
    honest: bool = False


class DrawnWorld(NamedTuple):
    """What is drawn beside the task, on which arm, with which condition of the eye model, what is asked."""

    axes: tuple[Axis, ...]
    demands: Demands
    eyes: EyeCondition
    arm: str = ARMS[0]


class WorldName(StrEnum):
    """What differs from machine to machine."""

    LAB = "lab"
    HARDER = "harder"
    REAL = "real"
    CRANE_REAL = "crane-real"


_HARDER = (axes_of_sight.lens, axes_of_sight.poor_light, axes_of_sight.tool_print, axes.wide_play)
_REAL = (
    axes.mobile_valves,
    axes.load_holding,
    axes.friction,
    axes.bending,
    axes.finer_bending,
    axes.play,
    axes.loose_slew,
    axes.tilting_bearing,
    axes.torsion,
    axes.soft_pins,
    axes.eccentric_encoders,
    axes.rocking_base,
    axes.payload_off_axis,
    axes.joint_axes,
    axes.oil,
    axes.supply,
    axes_of_sight.rectification,
    axes_of_sight.lens,
    axes_of_sight.two_lenses,
    axes_of_sight.drift,
    axes_of_sight.stamps,
    axes_of_sight.light,
    axes_of_sight.rolling_shutter,
    axes_of_sight.exposure,
    axes_of_sight.glare,
    axes_of_sight.moving_shadow,
    axes_of_sight.uneven_wall,
    axes_of_sight.broken_wall,
    axes_of_sight.passers,
    axes_of_sight.tool_print,
    axes_of_sight.object_markers,
)

_LAB_DEMANDS = Demands(0.98, None, open_loop=0.90, median_mm=1.5, q95_mm=3.0, honest=True)
_REAL_DEMANDS = Demands(0.95, 0.99, q95_mm=3.5, honest=True)
_CRANE_DEMANDS = Demands(0.90, 0.97, q95_mm=3.5, honest=True)

WORLDS: Mapping[WorldName, DrawnWorld] = {
    WorldName.LAB: DrawnWorld((), _LAB_DEMANDS, "usual"),
    WorldName.HARDER: DrawnWorld(_HARDER, Demands(0.95), "harder"),
    WorldName.REAL: DrawnWorld(_REAL, _REAL_DEMANDS, "harder"),
    WorldName.CRANE_REAL: DrawnWorld(_REAL, _CRANE_DEMANDS, "harder", ARMS[1]),
}


def drawn(world: DrawnWorld, seed: int, stream: int, usual: Settings) -> dict[str, Any]:
    """The overrides (file name → nested keys) of all the world's axes, each from a stream of its own.

    ``stream`` tells apart what else is drawn from the same ``seed``; ``usual`` is what the axes lie over.
    """
    overrides: dict[str, Any] = {}
    for axis in world.axes:
        rng = np.random.default_rng([seed, stream, crc32(axis.name.encode())])
        overrides = merged(overrides, axis.draw(rng, usual))
    return overrides
