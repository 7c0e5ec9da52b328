"""Recorded scans through both joint laws, Python's and the text's: the same spools, poses and Jacobians."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.kinematics.denavit_hartenberg import damped_inverse
from controller.core.kinematics.inverse_kinematics import joint_angles
from controller.core.kinematics.rotations import matrix_from_quaternion
from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanState, initial_state
from controller.core.servo.servo_step import tool_state
from controller.core.settings import ScanSettings, settings_from
from controller_st.program import texts
from foundation.configuration import load
from nominal_arm.description import NominalArm
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode
from protocol.pose import Pose
from protocol.process_image import decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import Command, ReferencePose, Request
from structured_text.memory import MemoryView
from structured_text.program import CompiledProgram
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

SPOOL, EXACT = 1e-9, 1e-12
SCANS = 10_000


class Recorded(NamedTuple):
    """A scan of Python's controller on the emulated oil: its state before and after, its input image."""

    before: ScanState
    after: ScanState
    words: list[int]


@cache
def program() -> CompiledProgram:
    arm, config = load(NominalArm, CONFIGS / "arm.yaml"), load(ControllerConfig, CONFIGS / "controller.yaml")
    return CompiledProgram(texts(arm, config))


@cache
def settings() -> ScanSettings:
    shipped = load_settings(CONFIGS, {})
    return settings_from(shipped.arm, shipped.controller)


def goals(rng: np.random.Generator, here: Pose) -> Pose:
    x, y, z = (float(p + d) for p, d in zip(here.p_m, rng.uniform(-0.25, 0.25, 3), strict=True))
    turn = np.array([1.0, *rng.uniform(-0.08, 0.08, 3)])
    w, i, j, k = (turn / np.linalg.norm(turn)).tolist()
    a, b, c, d = here.q_wxyz
    q = (w * a - i * b - j * c - k * d, w * b + i * a + j * d - k * c,
         w * c - i * d + j * a + k * b, w * d + i * c - j * b + k * a)  # fmt: skip
    return Pose((x, y, z), q)


@pytest.fixture(scope="module")
def recorded() -> list[Recorded]:
    """Moves to random places, a reference over another one, stops: every fifth scan is given a new place."""
    shipped, rng = load_settings(CONFIGS, {}), np.random.default_rng(7)
    plant = Plant(shipped.plant, 1, Scene(shipped.scene).mounts)
    state, found = initial_state(settings()), []
    home, valves = None, encode_valves(decode_valves([0] * 12))
    for number in range(1, SCANS + 1):
        plant.write(decode_valves(valves))
        words = encode_sensors(plant.read())
        requests: tuple[Request, ...] = ()
        if number == 5:
            requests = (Command(number, CommandCode.ENABLE),)
        elif home is not None and number % 700 == 20:
            requests = (ReferencePose(number, goals(rng, home), 0.0),)
        elif number % 2100 == 900:
            requests = (Command(number, CommandCode.STOP),)
        inputs = ScanInput(
            number * 5_000_000, number * 5_000_000, 0.005, decode_sensors(words), requests, True
        )
        after, output = scan(settings(), state, inputs)
        found.append(Recorded(state, after, words))
        state, valves = after, encode_valves(output.valves)
        if number == 10:
            home = output.view.X_BT
        plant.advance(5_000_000)
    assert state.fault.code == 0
    return found


def put(view: MemoryView, **values: Any) -> None:
    for name, value in values.items():
        setattr(view, name, value)


def spools(one: Recorded, kept: dict[str, MemoryView]) -> np.ndarray:
    """What the text's joint law makes of the scan's tool, motion and filters."""
    before, after = one.before, one.after
    servo, tool, desired, watch = kept["servo"], kept["tool"], kept["desired"], kept["watch"]
    put(servo, aqCmd=before.servo.q_cmd, aPt1=before.filters.pt1, aLoad=before.filters.load)
    put(tool, p=after.tool.p_BT, q=after.tool.quaternion, aJ=after.tool.J_BT)
    motion = after.motion.desired
    put(
        desired,
        p=motion.p,
        v=motion.v,
        a=motion.a,
        q=motion.quaternion,
        omega=motion.omega,
        alpha=motion.alpha,
    )
    kept["words"].numbers[:] = one.words
    program().call("F_LR_ReadInputs", aWords=kept["words"], stData=watch.stInputs)
    put(watch, xSeen=True, aq=after.watch.q_meas)
    whole = {"stServo": servo, "stTool": tool, "stDesired": desired, "stWatch": watch}
    assert program().call("F_LR_ServoStep", **whole, fRate=1.0, fDt=0.005).result
    return np.array(servo.aValves.numbers)


@pytest.mark.timeout(900)
@pytest.mark.slow("10,000 scans on the emulated oil, through both laws")
def test_both_joint_laws_make_the_same_spools_of_recorded_images(recorded: list[Recorded]) -> None:
    names = {
        "servo": "ST_LR_Servo", "tool": "ST_LR_Tool", "desired": "ST_LR_Desired", "watch": "ST_LR_Watch",
        "words": "T_LR_InputWords",
    }  # fmt: skip
    kept = {name: program().new(of) for name, of in names.items()}
    live = [one for one in recorded if one.after.mode.name in ("STANDBY", "MOVING", "STOPPING")]
    assert len(live) > 0.99 * SCANS
    assert sum(one.after.mode.name == "MOVING" for one in live) > 0.2 * SCANS
    worst = 0.0
    for one in live:
        if one.before.mode is one.after.mode:  # on enabling, filters begin anew
            worst = max(worst, float(np.abs(spools(one, kept) - one.after.servo.valves).max()))
    assert worst < SPOOL


def test_tool_jacobian_inverse_and_joint_angles_are_the_same() -> None:
    rng, table = np.random.default_rng(1), settings().table
    low, high = settings().planning.planned_range
    for _ in range(500):
        q = rng.uniform(low, high)
        angles, branch = program().new("T_LR_Joints"), program().new("T_LR_Joints")
        angles.numbers[:], branch.numbers[:] = q, q + rng.uniform(-0.1, 0.1, 6)
        python = tool_state(table, q)
        text = program().call("F_LR_ToolState", aq=angles).outputs["stTool"]
        assert np.abs(text.p.numbers - python.p_BT).max() < EXACT
        assert np.abs(text.q.numbers - python.quaternion).max() < EXACT
        assert np.abs(text.aJ.numbers - python.J_BT).max() < EXACT
        inverse, least, _ = damped_inverse(python.J_BT, 0.05, 0.05)
        solved = program().call("F_LR_DampedInverse", aJ=text.aJ, fOnset=0.05, fDamping=0.05)
        assert solved.result == pytest.approx(least, abs=EXACT)
        assert np.abs(solved.outputs["aInverse"].numbers - inverse).max() < 1e-11 * np.abs(inverse).max()
        R_BT = matrix_from_quaternion(python.quaternion)
        _, expected, _, _ = joint_angles(table, R_BT, python.p_BT, branch.numbers.copy())
        found = program().call("F_LR_JointAngles", p=text.p, q=text.q, aBranch=branch)
        assert found.result
        assert np.abs(found.outputs["aq"].numbers - expected).max() < 1e-11
