"""A joint behind a valve of known faults: play, deadband, flow; a quantised angle, no oil spring."""

import math
from dataclasses import dataclass, field

import numpy as np

from controller.config import ControllerConfig
from controller.core.excitation.plan import (
    Excitation,
    ExcitationPlan,
    Failure,
    Measured,
    Phase,
    begun,
    excitation_plan,
)
from controller.core.excitation.program import ExcitationSample
from controller.core.excitation.strokes import excite
from foundation.configuration import load
from nominal_arm.description import NominalArm
from tests.controller.conftest import CONFIGS

DT_S = 0.01
LSB = 2.0 * np.pi / 2**17
FULL_SPEED = 2.0
RETURN_BAR = 10.0
START = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])


def arm() -> NominalArm:
    return load(NominalArm, CONFIGS / "arm.yaml")


def plan_for(*joints: int) -> ExcitationPlan:
    chosen = {"excitation": {"enabled": True, "joints": list(joints)}}
    plan = excitation_plan(arm(), load(ControllerConfig, CONFIGS / "controller.yaml", chosen))
    assert plan is not None
    return plan


@dataclass
class ToyValve:
    """``raise_at``, ``lower_at``: deadbands of the spool, signs apart; ``play``: full hysteresis; ``gain``:
    flow over nominal; ``delay_s`` before the spool hears; ``friction_bar``: of the load pressure.
    ``outlet_at``, ``outlet_gain``: of the edge that lets a load go which runs ahead of its oil, raising."""

    joint: int
    raise_at: float = 0.05
    lower_at: float = 0.05
    play: float = 0.0
    gain: float = 1.0
    delay_s: float = 0.0
    friction_bar: float = 8.0
    swapped: bool = False
    dead: bool = False
    outlet_at: float = np.inf
    outlet_gain: float = 0.0
    curve: float = 0.0  # of the flow: f(x) = x + curve x²
    stop_at: float = np.inf  # rad of turn from the start
    swing_rad_s: float = 0.0
    seed: int = 0
    spool: float = 0.0
    q: np.ndarray = field(default_factory=START.copy)
    load_bar: float = 0.0
    time_s: float = 0.0
    ahead: bool = False
    commands: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.noise = 0.3 * LSB * np.random.default_rng(self.seed).standard_normal((4096, 6))

    def step(self, command: float) -> None:
        self.commands.append(command)
        self.time_s += DT_S
        late = round(self.delay_s / DT_S) + 1
        heard = self.commands[-late] if len(self.commands) >= late else 0.0
        self.spool = min(max(self.spool, heard - 0.5 * self.play), heard + 0.5 * self.play)
        x = -self.spool if self.swapped else self.spool
        opening = max(x - self.raise_at, 0.0) if x > 0.0 else min(x + self.lower_at, 0.0)
        speed = 0.0 if self.dead else self.gain * FULL_SPEED * opening * (1.0 + self.curve * abs(opening))
        running = self.outlet_gain * FULL_SPEED * max(x - self.outlet_at, 0.0)
        self.ahead = running > max(speed, 0.0)
        speed = running if self.ahead else speed
        speed += self.swing_rad_s * math.sin(2.0 * math.pi * 6.0 * self.time_s) * (command != 0.0)
        self.q[self.joint] = min(self.q[self.joint] + DT_S * speed, START[self.joint] + self.stop_at)
        self.load_bar = self.friction_bar * math.copysign(1.0, speed) if speed else self.load_bar

    def seen(self) -> np.ndarray:
        counted: np.ndarray = np.rint((self.q + self.noise[len(self.commands) % 4096]) / LSB) * LSB
        return counted


def tried(valve: ToyValve, plan: ExcitationPlan) -> tuple[Excitation, Failure | None, list[ExcitationSample]]:
    """The whole excitation of the toy's joint, and its record."""
    state, samples = begun(valve.seen()), list[ExcitationSample]()
    for cycle in range(200_000):
        q = valve.seen()
        before = state
        state, failure = excite(plan, state, Measured(q, 100.0), DT_S)
        driving = before.phase is not Phase.RESTING or state.spool != 0.0
        filled = RETURN_BAR if valve.ahead else 100.0 + 0.5 * valve.load_bar
        pressures = tuple((filled, 100.0 - 0.5 * valve.load_bar) for _ in range(6))
        samples.append(
            ExcitationSample(
                round(cycle * DT_S * 1e9), before.stroke, driving, state.spool, q, pressures,
                190.0, RETURN_BAR, (FULL_SPEED, FULL_SPEED),
            )
        )  # fmt: skip
        if failure is not None or state.phase is Phase.ENDED:
            return state, failure, samples
        valve.step(state.spool)
    raise AssertionError("the excitation never ended")
