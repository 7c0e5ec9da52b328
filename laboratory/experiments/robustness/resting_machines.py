"""Drawn machines with a drawn motion each, and how they come to its end: controller and plant alone."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple
from zlib import crc32

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from controller.core.settings import settings_from
from foundation.configuration import merged
from laboratory.experiments.positioning import axes
from laboratory.experiments.positioning.axes import JSON, Axis
from laboratory.experiments.positioning.corrected_run import commissioned
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from plant_emulator.core.plant import Plant
from protocol.errors import MeasurementFailed
from protocol.faults import FaultCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import ReferencePose
from testbed.lockstep.clock import ClosedLoop
from testbed.scenarios.arms import arm_overrides
from testbed.scenarios.scenario import Settings, load_settings

_STREAM = 0x72657374
_FURTHEST_M, _NEAREST_M, _TURN_DEG = 0.3, 0.03, 8.0
_TARGETS = 20
_MOST_KG = 100.0
VALVE_SETS = ("servo", "mobile")
REAL = "real"  # mobile valves, and all else that the real worlds draw of a machine
WORLD = "drawn targets within 0.3 m, 0 to 100 kg, friction ×0.6 to 1.7; mobile valves drawn"
_WARM_DEGC = 50.0  # [E] oil of an arm that has worked, in the air of plant.yaml
_OF_A_MACHINE: Mapping[str, tuple[Axis, ...]] = {
    "servo": (axes.friction,),
    "mobile": (axes.friction, axes.mobile_valves),
    REAL: tuple(axis for axis in WORLDS[WorldName.REAL].axes if getattr(axes, axis.name, None) is axis),
}

MachineKinds = Annotated[
    str, typer.Option("--machines", help="servo, mobile (valves), real (all of a machine), by commas.")
]


class DrawnMachine(NamedTuple):
    """A machine (its settings) with a load, before its motion; ``rng`` draws the motion."""

    settings: Settings
    mass_kg: float
    rng: np.random.Generator


def drawn_machine(config_dir: Path, task: JSON) -> DrawnMachine:
    """The machine of a task: ``seed``, ``arm``, ``valves``, ``cooling``.

    Mobile valves are drawn about plant.yaml's; all are stated as commissioned.
    ``real``: mobile valves, and whatever else the real worlds draw of a machine, camera and wall apart.
    """
    rng = np.random.default_rng([task["seed"], _STREAM])
    overrides = arm_overrides(config_dir, task["arm"])
    usual = load_settings(config_dir, overrides)
    mass_kg = rng.uniform(0.0, _MOST_KG)
    own: JSON = {"plant": {"payload": {"mass_kg": mass_kg}}}
    real = task["valves"] == REAL
    for axis in _OF_A_MACHINE[task["valves"]]:
        # a stream for each axis of ``real``: one that is added changes no other
        apart = np.random.default_rng([task["seed"], _STREAM, crc32(axis.name.encode())])
        own = merged(own, axis.draw(apart if real else rng, usual))
    if task.get("cooling"):
        cools = {"errors": {"cooling_oil": {"enabled": True}}, "oil": {"temperature_degc": _WARM_DEGC}}
        own = merged(own, {"plant": cools})
    over_all = merged(overrides, own)
    settings = load_settings(config_dir, over_all)
    settings = commissioned(config_dir, over_all, settings, task["seed"])
    return DrawnMachine(settings, mass_kg, rng)


def arrived(machine: DrawnMachine, seed: int) -> ClosedLoop:
    """The machine at the moment when the desired motion to a drawn target has ended.

    Raises MeasurementFailed with the cause of the controller's fault, or ``rest.no_target``.
    """
    settings = machine.settings
    loop = ClosedLoop(settings_from(settings.arm, settings.controller), Plant(settings.plant, seed))
    loop.enable()
    for pose in _targets(machine.rng, loop.view.X_BT):
        if loop.refer(lambda i, pose=pose: ReferencePose(i, pose, 0.0)) is Reason.ACCEPTED:  # type: ignore[misc]
            break
    else:
        raise MeasurementFailed("rest.no_target", f"none of {_TARGETS} drawn targets was accepted")
    while not loop.view.motion_done:
        stepped(loop)
    return loop


def _targets(rng: np.random.Generator, start: Pose) -> Iterator[Pose]:
    """Poses about ``start``, drawn."""
    w, x, y, z = start.q_wxyz
    for _ in range(_TARGETS):
        way = rng.normal(size=3)
        way *= rng.uniform(_NEAREST_M, _FURTHEST_M) / np.linalg.norm(way)
        turn = Rotation.from_rotvec(np.radians(rng.uniform(-_TURN_DEG, _TURN_DEG, 3)))
        i, j, k, real = (turn * Rotation.from_quat([x, y, z, w])).as_quat().tolist()
        px, py, pz = np.add(start.p_m, way).tolist()
        yield Pose((px, py, pz), (real, i, j, k))


def stepped(loop: ClosedLoop) -> None:
    """Pass one cycle. Raises MeasurementFailed with the controller's fault."""
    loop.step()
    fault = loop.view.fault
    if fault is not FaultCode.NONE:
        raise MeasurementFailed(f"fault.{fault.name.lower()}", f"{1e-9 * loop.now_ns:.1f} s after the start")


def machines(runs: int, first: int, kinds: str) -> Iterator[JSON]:
    """``seed``, ``arm`` and ``valves`` of so many runs: every kind with both arms in turn.

    Raises BadParameter for a kind that is not known.
    """
    sets = kinds.split(",")
    for name in sets:
        if name not in _OF_A_MACHINE:
            raise typer.BadParameter(f"no machines '{name}'; known: {', '.join(_OF_A_MACHINE)}")
    for k in range(runs):
        yield {"seed": first + k, "arm": ARMS[k // len(sets) % 2], "valves": sets[k % len(sets)]}
