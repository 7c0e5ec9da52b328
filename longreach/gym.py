"""The arm as a Gymnasium environment: six valves, the sensors, and a place to go, in simulated time.

Needs the extra: ``pip install longreach[gym]``. ``gymnasium.make("longreach.gym:longreach/Arm-v0")``.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from longreach.configured import CONFIGS, Assignments, configured
from longreach.models import SteppedPlant
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.plant import Plant
from protocol.errors import ConfigurationError
from protocol.process_image import COUNTS_PER_TURN, SensorImage
from testbed.scenarios.settings import Settings

Observation = dict[str, NDArray[np.float32]]

_CYCLE_S = 0.005  # of the fieldbus: valves are told as often as a controller tells them
_RAD = 2.0 * np.pi / COUNTS_PER_TURN
_BOUNDS = {  # name → limit, numbers; what leaves them is cut
    "angles": (4.0 * np.pi, 6),
    "rates": (10.0, 6),
    "pressures": (1000.0, 12),
    "supply": (1000.0, 1),
    "tool": (50.0, 3),
    "goal": (50.0, 3),
}


class ArmEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Bring the tool to a place nearby, with valves for hands and the sensors of a machine for eyes.

    Action (6,): spool commands in −1…1, base first, held for ``step_s``. Observation, as a controller has it:
    ``angles`` (6,) rad and ``rates`` (6,) rad/s of the encoders, ``pressures`` (12,) and ``supply`` (1,) bar,
    ``tool`` (3,) m, the tool centre point in B by the nominal arm, ``goal`` (3,) m in B. Reward: by how much
    ``tool`` came nearer to ``goal``, m. Terminated: it is within ``tolerance_m`` and rests. Truncated: after
    ``limit_s``. What is true stands in ``info`` alone: ``true_tool_m``, ``true_distance_m``, ``true_q``,
    ``payload_kg``, beside ``distance_m`` and ``time_s``.

    A seed given to ``reset`` is the world, as everywhere: of ``scenario``, which is then drawn anew, and of
    the plant. The same seed and actions give the same numbers to the last bit.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # Gymnasium's own declaration
    action_space = spaces.Box(-1.0, 1.0, (6,), np.float32)

    def __init__(
        self,
        scenario: str | None = None,
        arm: str | None = None,
        set: Assignments | None = None,
        config_dir: Path | str = CONFIGS,
        step_s: float = 0.02,
        limit_s: float = 10.0,
        tolerance_m: float = 0.01,
    ) -> None:
        """Raises ConfigurationError."""
        cycles = round(step_s / _CYCLE_S)
        if cycles < 1 or abs(cycles * _CYCLE_S - step_s) > 1e-9:
            why = f"step_s = {step_s}: wanted a multiple of {_CYCLE_S:g}"
            raise ConfigurationError("configuration.step", why)
        self.observation_space: Any = spaces.Dict(
            {name: spaces.Box(-limit, limit, (n,), np.float32) for name, (limit, n) in _BOUNDS.items()}
        )
        self._chosen = (config_dir, arm, scenario), set
        self._cycles, self._steps = cycles, round(limit_s / step_s)
        self._tolerance_m = tolerance_m
        self._settings = self._world(0)

    def _world(self, seed: int) -> Settings:
        where, assigned = self._chosen
        return configured(*where, seed, assigned)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """The arm at rest in a new world, with a new goal. ``options``: ``{"goal": (3,) m in B}``."""
        super().reset(seed=seed)
        world = int(self.np_random.integers(2**31)) if seed is None else seed
        if self._chosen[0][2] is not None:
            self._settings = self._world(world)
        settings = self._settings
        self._table = dh_table(settings.arm.dh)
        self._plant = SteppedPlant(Plant(settings.plant, world, Scene(settings.scene).mounts))
        self._sensors = self._before = self._plant.physics.read()
        goal = (options or {}).get("goal")
        self._goal = self._drawn_goal() if goal is None else np.asarray(goal, dtype=np.float64)
        self._step = 0
        return self._observed(), self._info()

    def _drawn_goal(self) -> NDArray[np.float64]:
        """Where the tool would be with every joint a little elsewhere: within the arm's reach."""
        return self._tool(self._angles(self._sensors) + self.np_random.uniform(-0.12, 0.12, 6))

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """``step_s`` of simulated time later."""
        distance_m = self._distance()
        self._before = self._sensors
        valves = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0).tolist()
        for _ in range(self._cycles):
            self._sensors = self._plant.step(valves, _CYCLE_S)
        self._step += 1
        observed = self._observed()
        rests = bool(np.abs(observed["rates"]).max() < 0.01)
        nearer_m = distance_m - self._distance()
        arrived = rests and self._distance() < self._tolerance_m
        return observed, float(nearer_m), arrived, self._step >= self._steps, self._info()

    @staticmethod
    def _angles(sensors: SensorImage) -> NDArray[np.float64]:
        return np.array(sensors.encoder_counts) * _RAD

    def _tool(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        return tool_pose(self._table, q)[:3, 3]

    def _distance(self) -> float:
        return float(np.linalg.norm(self._tool(self._angles(self._sensors)) - self._goal))

    def _observed(self) -> Observation:
        now, before = self._angles(self._sensors), self._angles(self._before)
        told = {
            "angles": now,
            "rates": (now - before) / (self._cycles * _CYCLE_S),
            "pressures": np.ravel(self._sensors.pressures_bar),
            "supply": np.array([self._sensors.supply_bar]),
            "tool": self._tool(now),
            "goal": self._goal,
        }
        return {
            name: np.clip(told[name], -limit, limit).astype(np.float32)
            for name, (limit, _) in _BOUNDS.items()
        }

    def _info(self) -> dict[str, Any]:
        truth = self._plant.truth
        return {
            "time_s": 1e-9 * truth.time_ns,
            "distance_m": self._distance(),
            "true_tool_m": truth.X_BT[:3, 3].copy(),
            "true_distance_m": float(np.linalg.norm(truth.X_BT[:3, 3] - self._goal)),
            "true_q": truth.q.copy(),
            "payload_kg": truth.payload_kg,
        }


gymnasium.register("longreach/Arm-v0", "longreach.gym:ArmEnv")
