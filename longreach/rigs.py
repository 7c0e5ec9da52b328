"""Rigs to drive: in simulated time in this process, or a running one over its REST API."""

import contextlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from foundation.command_options import usual_configs
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.errors import LongreachError, RequestRefused
from testbed.demonstration.sequence import Rig
from testbed.lockstep.clock import RunLog
from testbed.lockstep.rig import LockstepRig
from testbed.realtime.rest_rig import RestRig, look_of
from testbed.reporting.console import Bar
from testbed.scenarios.arms import arm_directory
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from vision_pc.application.program import Program
from vision_pc.application.programs import PROGRAMS
from vision_pc.application.results import JSON, JudgedLook

CONFIGS = usual_configs()  # as the command line's --config-dir
Assignments = Mapping[str, Any]
"""As ``--set``: ``{"plant.payload.mass_kg": 80}``."""


def configured(
    config_dir: Path | str, arm: str | None, scenario: str | None, seed: int, set: Assignments | None
) -> Settings:
    """Every file of ``config_dir``, or of an arm in it, with a scenario's world and the assignments over it.

    Raises ConfigurationError.
    """
    assignments = [f"{key}={json.dumps(value)}" for key, value in (set or {}).items()]
    folder = Path(config_dir) if arm is None else arm_directory(Path(config_dir), arm)
    return load_settings(folder, chosen_overrides(folder, scenario, seed, assignments))


CANCELLED = "refused.cancelled"


class _CancelBar(Bar):
    """A report that ends its program once it is cancelled."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()

    def update(self, fraction: float, note: str = "") -> None:
        """Go on, or raise RequestRefused."""
        if self.cancelled.is_set():
            raise RequestRefused(CANCELLED, "cancelled by the caller")


class DrivenRig:
    """What every rig does. Each call returns when it is done, or raises LongreachError with its cause."""

    def __init__(self, rig: Rig, operate: Callable[[str, JSON, Bar], Any]) -> None:
        self._rig, self._operate = rig, operate
        self._bar = _CancelBar()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the rig; a running one goes on."""

    def enable(self) -> None:
        """Let the arm move."""
        self._rig.command("enable")

    def disable(self) -> None:
        """Let the arm no longer move."""
        self._rig.command("disable")

    def stop(self) -> None:
        """Stop the arm."""
        self._rig.command("stop")

    def reset(self) -> None:
        """Clear a latched fault."""
        self._rig.command("reset")

    def look(self) -> JudgedLook:
        """Tool and object as the camera sees them at rest, and the verdict against the tolerance.

        Over REST the covariances are the standard deviations that the API tells, taken as independent.
        """
        look: JudgedLook = self.run("look")
        return look

    def run(self, program: str, /, **request: Any) -> Any:
        """The result of a program of the REST API, such as ``look-then-move``, with its members.

        In lockstep it is the program's type, over REST the API's JSON. What ends it early stops the arm.
        """
        self._bar.cancelled.clear()
        return self._operate(program, request, self._bar)

    def cancel(self) -> None:
        """End the running program, from another thread: its ``run`` raises ``refused.cancelled``."""
        self._bar.cancelled.set()

    def picture(self) -> bytes:
        """The newest picture with what was found in it, PNG."""
        return self._rig.picture()


class SimulatedRig(DrivenRig):
    """Plant, controller and vision in simulated time; the truth is at hand. ``lockstep_rig``: all of it."""

    def __init__(self, rig: LockstepRig, world: str, record: Path | None) -> None:
        super().__init__(rig, rig.operate)
        self.lockstep_rig = rig
        self._world = world
        self._recordings = None if record is None else rig.record_in(record, f"lockstep {world}")

    def __repr__(self) -> str:
        return f"<SimulatedRig: {self._world}, at {self.time_s:.1f} s>"

    def close(self) -> None:
        """End the recordings, if there are any."""
        if self._recordings is not None:
            self._recordings.close()
            self._recordings = None

    @property
    def truth(self) -> PlantTruth:
        """Where everything really is now; no program knows it."""
        return self.plant.truth()

    @property
    def plant(self) -> Plant:
        """The plant, to change its load or to break it."""
        return self.lockstep_rig.world.plant

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return 1e-9 * self.lockstep_rig.world.time_ns


class ConnectedRig(DrivenRig):
    """A running rig over REST. It has no ``truth``: that is in the plant's recording alone."""

    def __init__(self, rig: RestRig, url: str) -> None:
        super().__init__(rig, rig.result)
        self._rest = rig
        self._url = url

    def __repr__(self) -> str:
        return f"<ConnectedRig: {self._url}>"

    def close(self) -> None:
        """Close the connection; the rig goes on."""
        self._rest.close()

    def look(self) -> JudgedLook:
        """As ``DrivenRig.look``."""
        return look_of(self.run("look"))

    def run(self, program: str, /, **request: Any) -> Any:
        """As ``DrivenRig.run``; Ctrl-C and a cancelled call stop the arm."""
        try:
            return super().run(program, **request)
        except BaseException as error:
            if not isinstance(error, LongreachError) or error.cause == CANCELLED:
                with contextlib.suppress(LongreachError):
                    self.stop()
            raise


def lockstep(
    scenario: str | None = None,
    seed: int = 1,
    set: Assignments | None = None,
    config_dir: Path | str = CONFIGS,
    programs: Sequence[Program[Any, Any]] = (),
    arm: str | None = None,
    record: Path | str | None = None,
) -> SimulatedRig:
    """A rig in simulated time, in the world that ``scenario`` draws for ``seed`` (None: as configured).

    The same seed is the same run. ``programs``: of your own, beside those of the API.
    ``arm``: a name or a directory, as the command line's ``--arm``. ``record``: a directory in which plant,
    controller and vision are recorded until the rig is closed.
    Raises ConfigurationError, and OSError where nothing can be recorded.
    """
    settings = configured(config_dir, arm, scenario, seed, set)
    rig = LockstepRig(settings, seed, RunLog(), programs=(*PROGRAMS, *programs))
    world = f"{settings.arm.name}, {scenario or 'as configured'}, seed {seed}"
    return SimulatedRig(rig, world, None if record is None else Path(record))


def connect(url: str, token: bytes | None = None) -> ConnectedRig:
    """The rig whose vision PC serves at ``url``; ``token``: of the role ``operate``, where it wants one.

    Nothing is sent yet: the first call raises LinkLost (``link.rest``) when nobody answers.
    """
    return ConnectedRig(RestRig(url, token), url)
