"""Speed and accuracy of the plant, beside MuJoCo stepping the same arm with the same oil.

Both get the same valve commands, oil equations (the plant's kernels) and mechanical parameters. MuJoCo steps
rigid bodies and elastic hinges by its implicit integrator; the oil advances by Euler sub-steps between the
instants at which torques and joint motion are exchanged. Costs are processor time of one thread, the best of
three rounds.
"""

import gc
import time
import tracemalloc
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.layout import DRIVEN, N_ACTUATORS, N_COORDINATES, N_STATES, RATE, Q
from plant_emulator.core.mechanics.elastic import start_angles
from plant_emulator.core.mechanics.multibody import forward_kinematics, multibody_work
from plant_emulator.core.model import Model, build_model
from plant_emulator.core.right_hand_side import EncoderShafts, Work, advance, hydraulic_rates, new_work
from testbed.reporting.console import out, table
from tests.plant_emulator.mechanics.structure_world import ENTRIES
from tests.plant_emulator.oracles import mujoco_xml
from tests.plant_emulator.plant_world import plant_config

Array = NDArray[np.float64]

CYCLE = 5e-3  # valve commands change at the controller's cycle
SECONDS = 4.0
SAMPLES = round(SECONDS / CYCLE)

PLAIN: Mapping[str, Any] = MappingProxyType({})
STRUCTURE = {"errors": {name: {"enabled": True} for name in ENTRIES}}
WHOLE = {  # what bends, slips and rocks besides; then all that a real machine has
    "whole structure, 0.5 ms": STRUCTURE,
    "whole structure and mobile valves, 0.5 ms": {**STRUCTURE, "valve_set": "mobile"},
}
pytestmark = [pytest.mark.bench, pytest.mark.timeout(600)]


def commands(k: int) -> Array:
    """Valve commands of the benchmark's motion: all six axes, smooth, with reversals."""
    t = k * CYCLE
    speeds = np.array([2.0, 1.7, 1.3, 3.0, 2.5, 4.0])
    return np.array([0.3, 0.25, -0.3, 0.2, 0.2, 0.3]) * np.sin(speeds * t + 0.05)


class Motion:
    """The default arm at rest with ``changes``, to be driven by either engine."""

    def __init__(self, changes: Mapping[str, Any] = PLAIN) -> None:
        config = plant_config(**changes)
        self.model, self.chain, _ = build_model(config)
        self.state = rest_state(
            self.model, start_angles(config, self.chain.names), config.oil.temperature_degc
        )
        self.work = new_work(self.model)

    def tip(self) -> Array:
        """The tool's position (3,) on the ground."""
        angles = self.state[self.model.places.angle]
        work = multibody_work(len(angles))
        forward_kinematics(angles, self.model.mechanism, work)
        return np.asarray(work.rotation[-1] @ self.chain.X_BT_home[:3, 3] + work.origin[-1])


def own_engine(step: float, changes: Mapping[str, Any] = PLAIN) -> tuple[Array, float]:
    """Tip positions (SAMPLES, 3) and microseconds per simulated millisecond of the plant's engine."""
    motion, drive, idle = Motion(changes), np.zeros(N_ACTUATORS), np.zeros(N_ACTUATORS)
    tips, spent = [], 0.0
    for k in range(SAMPLES):
        target, steps = commands(k), round(CYCLE / step)
        begin = time.thread_time()
        advance(
            motion.state, drive, target, EncoderShafts(idle, idle), steps, step, motion.model, motion.work
        )
        spent += time.thread_time() - begin
        tips.append(motion.tip())
    return np.array(tips), spent / SECONDS * 1e3


@kernel(error_model="numpy")
def oil_steps(
    state: Array, command: Array, steps: int, h: float, model: Model, work: Work, mean: Array
) -> None:
    """Advance the oil by Euler steps while the joints move on; ``mean`` (10,) is their mean torque."""
    rate = work.slope[0]
    for j in range(N_COORDINATES):
        mean[j] = 0.0
    for _ in range(steps):
        hydraulic_rates(state, command, model, work, rate)
        for j in range(N_COORDINATES):
            mean[j] += work.force[j] / steps
            rate[Q + j] = state[RATE + j]
            rate[RATE + j] = 0.0
        for j in range(N_STATES):
            state[j] += h * rate[j]


def mujoco_engine(coupling: float, substep: float) -> tuple[Array, float]:
    """The same of MuJoCo's multibody with the oil in sub-steps, coupled every ``coupling`` seconds."""
    motion = Motion()
    mech = motion.model.mechanism
    options = f"timestep='{coupling!r}' integrator='implicitfast'"
    model = mujoco.MjModel.from_xml_string(mujoco_xml(mech, options))
    data = mujoco.MjData(model)
    data.qpos[:] = motion.state[Q : Q + N_COORDINATES]
    torque, driven, tips, spent = np.zeros(N_COORDINATES), list(DRIVEN), [], 0.0
    for k in range(SAMPLES):
        command = commands(k)
        begin = time.thread_time()
        for _ in range(round(CYCLE / coupling)):
            oil_steps(
                motion.state, command, round(coupling / substep), substep, motion.model, motion.work, torque
            )
            data.qfrc_applied[driven] = torque[driven]
            mujoco.mj_step(model, data)
            motion.state[Q : Q + N_COORDINATES] = data.qpos
            motion.state[RATE : RATE + N_COORDINATES] = data.qvel
        spent += time.thread_time() - begin
        tips.append(motion.tip())
    return np.array(tips), spent / SECONDS * 1e3


class Row(NamedTuple):
    """One scheme's cost (µs per simulated ms) and worst tip errors (m).

    ``error`` is against the scheme's own 25 µs run, ``apart`` against the plant's.
    """

    name: str
    cost: float
    error: float
    apart: float


PLANT = {"plant, 0.5 ms": 5e-4, "plant, 0.25 ms": 2.5e-4, "plant, 0.125 ms": 1.25e-4}
PEER = {  # coupling and oil sub-step, s
    "MuJoCo, coupled at 1 ms": (1e-3, 1e-4),
    "MuJoCo, coupled at 0.5 ms": (5e-4, 1e-4),
    "MuJoCo, coupled at 0.25 ms": (2.5e-4, 1.25e-4),
    "MuJoCo, coupled at 0.1 ms": (1e-4, 1e-4),
}
FINEST = 2.5e-5
MOST_OF_PEER = 0.5  # of MuJoCo's processor time with the oil coupled at 0.1 ms, which is as exact
WHOLE_OF_PEER = 0.5
GREATEST_ERROR = 1e-5  # m
MANY = 20_000  # steps
BYTES_A_STEP = 0.1  # an array, or a number, of every step would be 16 at least


def worst(tips: Array, reference: Array) -> float:
    """The greatest distance (m) between two tracks of the tip."""
    return float(np.linalg.norm(tips - reference, axis=1).max())


@pytest.fixture(scope="module")
def references() -> tuple[Array, Array]:
    """The tracks of plant and peer at 25 µs."""
    return own_engine(FINEST)[0], mujoco_engine(FINEST, FINEST)[0]


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return []


def measure(benchmark: Any, name: str, run: Any, arguments: tuple[Any, ...], own: Array, plant: Array) -> Row:
    rounds: list[tuple[Array, float]] = []
    benchmark.pedantic(lambda: rounds.append(run(*arguments)), rounds=3, warmup_rounds=1)
    tips, cost = rounds[-1][0], min(spent for _, spent in rounds)
    row = Row(name, cost, worst(tips, own), worst(tips, plant))
    benchmark.extra_info.update(row._asdict())
    return row


@pytest.mark.parametrize("name", PLANT)
def test_plant(benchmark: Any, name: str, references: tuple[Array, Array], rows: list[Row]) -> None:
    """Four seconds of all six axes by the plant's own engine."""
    plant, _ = references
    rows.append(measure(benchmark, name, own_engine, (PLANT[name],), plant, plant))


@pytest.mark.parametrize("name", WHOLE)
def test_whole_structure(benchmark: Any, name: str, rows: list[Row]) -> None:
    """The same four seconds with all that bends, slips and rocks: 24 angles, a play that is gone through."""
    reference = own_engine(FINEST, WHOLE[name])[0]
    rows.append(measure(benchmark, name, own_engine, (5e-4, WHOLE[name]), reference, reference))


@pytest.mark.parametrize("name", PEER)
def test_peer(benchmark: Any, name: str, references: tuple[Array, Array], rows: list[Row]) -> None:
    """The same four seconds by MuJoCo."""
    plant, peer = references
    rows.append(measure(benchmark, name, mujoco_engine, PEER[name], peer, plant))


def allocations(steps: int) -> tuple[int, int]:
    """What ``steps`` steps in one call take: blocks of numba's run-time system, bytes of Python's at most.

    The least of three: bytes are counted for all of the process.
    """
    return min(_allocated(steps) for _ in range(3))


def _allocated(steps: int) -> tuple[int, int]:
    motion = Motion()
    shafts = EncoderShafts(np.zeros(N_ACTUATORS), np.zeros(N_ACTUATORS))
    arrays = [np.zeros(N_ACTUATORS), commands(10), shafts]
    advance(motion.state, *arrays, 1, 5e-4, motion.model, motion.work)
    _nrt_python.memsys_enable_stats()
    gc.disable()
    tracemalloc.start()
    blocks = rtsys.get_allocation_stats().alloc
    advance(motion.state, *arrays, steps, 5e-4, motion.model, motion.work)
    blocks, peak = rtsys.get_allocation_stats().alloc - blocks, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    gc.enable()
    return blocks, peak


def test_limits(references: tuple[Array, Array], rows: list[Row]) -> None:
    """The table of this run, and what is wanted of it."""
    columns = (
        "scheme",
        "µs per simulated ms",
        "times real time",
        "error, mm (own 25 µs)",
        "off the plant, mm",
    )
    lines: list[tuple[object, ...]] = [
        (r.name, f"{r.cost:.1f}", f"{1e3 / r.cost:.1f}", f"{r.error * 1e3:.5f}", f"{r.apart * 1e3:.4f}")
        for r in rows
    ]
    lines.append(
        ("MuJoCo, coupled at 25 µs", "", "", "0", f"{worst(references[1], references[0]) * 1e3:.4f}")
    )
    out.print(table("4 s of all six axes: speed and worst tip error", columns, lines))
    own = next(row for row in rows if row.name == "plant, 0.5 ms")
    wholes = [row for row in rows if row.name in WHOLE]
    whole, error = max(row.cost for row in wholes), max(row.error for row in wholes)
    one, many = allocations(1), allocations(MANY)
    peer = next(row.cost for row in rows if row.name == list(PEER)[-1])
    bytes_a_step = (many[1] - one[1]) / MANY
    verdicts = [
        ("cost at 0.5 ms over MuJoCo's, coupled at 0.1 ms", f"≤ {MOST_OF_PEER:g}",
         f"{own.cost / peer:.2f}", own.cost <= MOST_OF_PEER * peer),
        ("worst tip error at 0.5 ms, mm", f"< {GREATEST_ERROR * 1e3:g}", f"{own.error * 1e3:.5f}",
         own.error < GREATEST_ERROR),
        ("cost of the whole structure, either valves, over the same", f"≤ {WHOLE_OF_PEER:g}",
         f"{whole / peer:.2f}", whole <= WHOLE_OF_PEER * peer),
        ("worst tip error of the whole structure, mm", f"< {GREATEST_ERROR * 1e3:g}", f"{error * 1e3:.5f}",
         error < GREATEST_ERROR),
        (f"blocks allocated by {MANY} steps, beyond those by one", "0", many[0] - one[0], many[0] == one[0]),
        ("greatest number of Python's bytes in use, a step, beyond those by one", f"≤ {BYTES_A_STEP:g}",
         f"{bytes_a_step:.3f}", bytes_a_step <= BYTES_A_STEP),
    ]  # fmt: skip
    shown = [(*line[:3], "passed" if line[3] else "FAILED") for line in verdicts]
    out.print(table("limits", ("figure", "limit", "obtained", "verdict"), shown))
    failed = [line[0] for line in verdicts if not line[3]]
    assert not failed
