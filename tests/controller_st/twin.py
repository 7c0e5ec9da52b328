"""Scans of Python's controller on the emulated oil, and what the text's joint law makes of them."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from controller.core.scan import scan
from controller.core.scan_types import ScanInput, ScanState, initial_state
from controller.core.settings import settings_from
from controller.core.standing import rest_before
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode
from protocol.pose import Pose
from protocol.process_image import decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import Command, ReferencePose, Request
from structured_text.errors import ProgramFaulted
from structured_text.memory import MemoryView
from structured_text.program import CompiledProgram
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

_TYPES = {
    "servo": "ST_LR_Servo",
    "tool": "ST_LR_Tool",
    "desired": "ST_LR_Desired",
    "watch": "ST_LR_Watch",
    "words": "T_LR_InputWords",
    "joints": "T_LR_Joints",
}
_EVERY = 700  # scans from one place to the next


class Recorded(NamedTuple):
    """A scan of Python's controller: its state before and after, its input image."""

    before: ScanState
    after: ScanState
    words: list[int]


class Twin(NamedTuple):
    """The scans with the valves live; on enabling, filters begin anew."""

    scans: list[Recorded]

    @property
    def live(self) -> list[Recorded]:
        """Those that both laws can be compared in."""
        modes = ("STANDBY", "MOVING", "STOPPING")
        return [s for s in self.scans if s.after.mode.name in modes and s.before.mode is s.after.mode]


def _goal(rng: np.random.Generator, here: Pose) -> Pose:
    x, y, z = (float(p + d) for p, d in zip(here.p_m, rng.uniform(-0.25, 0.25, 3), strict=True))
    turn = np.array([1.0, *rng.uniform(-0.08, 0.08, 3)])
    w, i, j, k = (turn / np.linalg.norm(turn)).tolist()
    a, b, c, d = here.q_wxyz
    q = (
        w * a - i * b - j * c - k * d,
        w * b + i * a + j * d - k * c,
        w * c - i * d + j * a + k * b,
        w * d + i * c - j * b + k * a,
    )
    return Pose((x, y, z), q)


def recorded_scans(count: int) -> list[Recorded]:
    """So many scans: moves to random places, one over the other, and stops."""
    shipped, rng = load_settings(CONFIGS, {}), np.random.default_rng(7)
    settings = settings_from(shipped.arm, shipped.controller)
    plant = Plant(shipped.plant, 1, Scene(shipped.scene).mounts)
    state, found = initial_state(settings), []
    home, valves = None, [0] * 12
    for number in range(1, count + 1):
        plant.write(decode_valves(valves))
        words = encode_sensors(plant.read())
        requests: tuple[Request, ...] = ()
        if number == 5:
            requests = (Command(number, CommandCode.ENABLE),)
        elif home is not None and number % _EVERY == 20:
            requests = (ReferencePose(number, _goal(rng, home), 0.0),)
        elif number % (3 * _EVERY) == 900:
            requests = (Command(number, CommandCode.STOP),)
        now_ns = number * 5_000_000
        inputs = ScanInput(now_ns, now_ns, 0.005, decode_sensors(words), requests, True)
        after, output = scan(settings, state, inputs)
        found.append(Recorded(state, after, words))
        state, valves = after, encode_valves(output.valves)
        home = output.view.X_BT if number == 10 else home
        plant.advance(5_000_000)
    assert state.fault.code == 0
    return found


def _put(view: MemoryView, **values: Any) -> None:
    for name, value in values.items():
        setattr(view, name, value)


def _spools(program: CompiledProgram, one: Recorded, cells: dict[str, MemoryView]) -> npt.NDArray[np.float64]:
    before, after = one.before, one.after
    servo, tool, desired, watch = cells["servo"], cells["tool"], cells["desired"], cells["watch"]
    _put(servo, aqCmd=before.servo.q_cmd, aPt1=before.filters.pt1, aLoad=before.filters.load)
    held, error, stood = rest_before(after._replace(settling=before.settling))[0]
    _put(servo, aHeld=held > 0.0, aError=error, aStood=stood)
    _put(tool, p=after.tool.p_BT, q=after.tool.quaternion, aJ=after.tool.J_BT)
    motion = after.motion.desired
    _put(desired, p=motion.p, v=motion.v, a=motion.a)
    _put(desired, q=motion.quaternion, omega=motion.omega, alpha=motion.alpha)
    cells["words"].numbers[:] = one.words
    program.call("F_LR_ReadInputs", aWords=cells["words"], stData=watch.stInputs)
    _put(watch, xSeen=True, aq=after.watch.q_meas)
    whole = {"stServo": servo, "stTool": tool, "stDesired": desired, "stWatch": watch}
    assert program.call("F_LR_ServoStep", **whole, fRate=1.0, fDt=0.005).result
    return np.array(servo.aValves.numbers)


def worst_of(program: CompiledProgram, twin: Twin) -> float:
    """The furthest that a spool, the tool's pose or the Jacobian is off; infinite for a fault."""
    cells = {name: program.new(of) for name, of in _TYPES.items()}
    worst = 0.0
    try:
        for one in twin.live:
            cells["joints"].numbers[:] = one.after.watch.q_meas
            found = program.call("F_LR_ToolState", aq=cells["joints"]).outputs["stTool"]
            tool, spools = one.after.tool, _spools(program, one, cells)
            pairs = (
                (spools, one.after.servo.valves),
                (cells["servo"].aError.numbers, one.after.settling.error),
                (found.p.numbers, tool.p_BT),
                (found.q.numbers, tool.quaternion),
                (found.aJ.numbers, tool.J_BT),
            )
            worst = max(worst, *(float(np.abs(text - python).max()) for text, python in pairs))
    except ProgramFaulted:
        return float("inf")
    return worst
