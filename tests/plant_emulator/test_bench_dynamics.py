"""Speed and accuracy of the plant, beside MuJoCo stepping the same arm with the same oil."""

import math
import time
from typing import Any

import mujoco
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.layout import DRIVEN, N_ACTUATORS, N_COORDINATES, N_STATES, RATE, Q
from plant_emulator.core.model import Model, build_model, start_coordinates
from plant_emulator.core.multibody import forward_kinematics, multibody_work
from plant_emulator.core.right_hand_side import Work, advance, hydraulic_rates, new_work
from testbed.validation.oracles import mujoco_xml
from tests.plant_emulator.plant_world import plant_config

Array = NDArray[np.float64]

CYCLE = 5e-3  # valve commands change at the controller's cycle
SECONDS = 4.0
SAMPLES = round(SECONDS / CYCLE)

pytestmark = [pytest.mark.bench, pytest.mark.timeout(600)]


def commands(k: int) -> Array:
    """Valve commands of the benchmark's motion: all six axes, smooth, with reversals."""
    t = k * CYCLE
    speeds = np.array([2.0, 1.7, 1.3, 3.0, 2.5, 4.0])
    return np.array([0.3, 0.25, -0.3, 0.2, 0.2, 0.3]) * np.sin(speeds * t + 0.05)


class Motion:
    """The default arm at rest, to be driven by either engine."""

    def __init__(self) -> None:
        config = plant_config()
        self.model, self.chain, _ = build_model(config)
        self.state = rest_state(self.model, start_coordinates(config), config.oil.temperature_degc)
        self.work = new_work()

    def tip(self) -> Array:
        """The tool's position (3,) in B."""
        work = multibody_work(N_COORDINATES)
        forward_kinematics(self.state[Q : Q + N_COORDINATES], self.model.mechanism, work)
        return np.asarray(work.rotation[-1] @ self.chain.X_BT_home[:3, 3] + work.origin[-1])


def own_engine(step: float) -> tuple[Array, float]:
    """Tip positions (SAMPLES, 3) and microseconds per simulated millisecond of the plant's engine."""
    motion, drive, idle = Motion(), np.zeros(N_ACTUATORS), np.zeros(N_ACTUATORS)
    tips, spent = [], 0.0
    for k in range(SAMPLES):
        target, steps = commands(k), round(CYCLE / step)
        begin = time.perf_counter()
        advance(motion.state, drive, target, idle, idle, steps, step, motion.model, motion.work)
        spent += time.perf_counter() - begin
        tips.append(motion.tip())
    return np.array(tips), spent / SECONDS * 1e3


@njit(cache=True, error_model="numpy")
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
        begin = time.perf_counter()
        for _ in range(round(CYCLE / coupling)):
            oil_steps(
                motion.state, command, round(coupling / substep), substep, motion.model, motion.work, torque
            )
            data.qfrc_applied[driven] = torque[driven]
            mujoco.mj_step(model, data)
            motion.state[Q : Q + N_COORDINATES] = data.qpos
            motion.state[RATE : RATE + N_COORDINATES] = data.qvel
        spent += time.perf_counter() - begin
        tips.append(motion.tip())
    return np.array(tips), spent / SECONDS * 1e3


@pytest.fixture(scope="module")
def reference() -> Array:
    own_engine(5e-4)  # compile, outside of all timing
    return own_engine(2.5e-5)[0]


@pytest.mark.parametrize(
    ("engine", "arguments"),
    [
        (own_engine, (5e-4,)),
        (own_engine, (2.5e-4,)),
        (mujoco_engine, (1e-3, 1e-4)),
        (mujoco_engine, (1e-4, 1e-4)),
    ],
    ids=["own 0.5 ms", "own 0.25 ms", "mujoco coupled at 1 ms", "mujoco coupled at 0.1 ms"],
)
def test_four_seconds_of_motion(
    benchmark: Any, reference: Array, engine: Any, arguments: tuple[float, ...]
) -> None:
    """4 s of all six axes; the worst tip error against 25 µs stands in the table's extra columns."""
    tips, cost = benchmark.pedantic(engine, args=arguments, rounds=3, warmup_rounds=1)
    worst = float(np.linalg.norm(tips - reference, axis=1).max())
    benchmark.extra_info["us_per_simulated_ms"] = round(cost, 1)
    benchmark.extra_info["times_real_time"] = round(1e3 / cost, 1)
    benchmark.extra_info["tip_error_mm"] = round(worst * 1e3, 5)
    print(f"{cost:7.1f} µs per simulated ms, {1e3 / cost:5.1f} × real time, tip error {worst * 1e3:.5f} mm")
    assert math.isfinite(worst)
    if engine is own_engine and arguments == (5e-4,):
        assert worst < 1e-5
        assert 1e3 / cost >= 12.0
