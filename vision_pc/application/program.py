"""What a program is: one row that says everything which the API, lockstep and the page need to know of it."""

from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from foundation.configuration import validated
from protocol.errors import ConfigurationError, LinkLost, RequestRefused
from protocol.faults import FaultCode, GroupState
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import RequestBody
from vision_pc.application.results import JSON
from vision_pc.core.ports import Report

SettingsT = TypeVar("SettingsT", bound=BaseModel)
ResultT = TypeVar("ResultT")
Need = Callable[[VisionApplication, str, Any], None]
"""A condition: called with the application, the program's name and its settings, it raises when unmet."""


def camera(application: VisionApplication, name: str, settings: Any) -> None:
    """Fresh pictures come."""
    status = application.camera.status()
    if not status.connected:
        raise LinkLost(status.trouble or "link.camera_silent", "no fresh pictures from the camera")


def at_rest(application: VisionApplication, name: str, settings: Any) -> None:
    """The arm does not move."""
    if application.controller.state.group_state is GroupState.MOVING:
        raise RequestRefused("refused.moving", f"{name}: the arm is moving")


def enabled(application: VisionApplication, name: str, settings: Any) -> None:
    """The arm may move: it is enabled, without a latched stop or fault."""
    state = application.controller.state
    group, fault = state.group_state, state.fault
    latched = "" if fault is FaultCode.NONE else f" ({fault.name.lower()})"
    for is_so, cause, why in (
        (state.flags & FLAG_EMERGENCY_LATCHED, "emergency_latched", "the emergency stop is latched"),
        (group is GroupState.ERROR_STOP, "error_latched", f"a fault is latched{latched}; reset first"),
        (group is GroupState.STOPPING, "stopping", "the arm is stopping"),
        (group is GroupState.DISABLED, "disabled", "the arm is disabled; enable first"),
    ):
        if is_so:
            raise RequestRefused(f"refused.{cause}", f"{name}: {why}")


def recording(application: VisionApplication, name: str, settings: Any) -> None:
    """Events can be recorded."""
    if not application.log.healthy:
        raise RequestRefused("refused.recording_failed", f"{name}: events can no longer be recorded")


STANDING: tuple[Need, ...] = (camera, at_rest)
"""What a program needs that looks and moves nothing."""
MOVING: tuple[Need, ...] = (camera, at_rest, enabled, recording)
"""What a program needs that looks and moves."""
BLIND: tuple[Need, ...] = (at_rest, enabled, recording)
"""What a program needs that moves without looking."""


@dataclass(frozen=True)
class Program(Generic[SettingsT, ResultT]):
    """One program.

    ``name`` is its address in the API and its name in logs, ``title`` what it does in one line. ``run``
    is called with the application, the settings of this request and a report; it returns a typed result,
    of which ``to_json`` makes what the API answers (mm, degrees). ``body`` is what a request may say,
    laid over ``settings`` (None: the body itself is what ``run`` gets). ``needs`` must all be met before
    it begins, in this order. ``core`` is the function to read, ``source`` where its method comes from,
    ``tag`` its group.
    """

    name: str
    title: str
    run: Callable[[VisionApplication, SettingsT, Report], Coroutine[Any, Any, ResultT]]
    to_json: Callable[[ResultT], JSON]
    body: type[RequestBody] = RequestBody
    settings: Callable[[VisionApplication], SettingsT] | None = None
    needs: tuple[Need, ...] = MOVING
    core: Callable[..., Any] | None = None
    source: str = "–"
    tag: str = "operations"

    def requested(self, application: VisionApplication, body: RequestBody) -> BaseModel:
        """The settings of one request.

        Raises ConfigurationError (a 422 problem) when the combination is out of range.
        """
        if self.settings is None:
            return body
        configured = self.settings(application)
        return validated(type(configured), configured.model_dump() | body.overrides(), "request")

    def refuse_now(self, application: VisionApplication, settings: Any) -> None:
        """Raises RequestRefused or LinkLost when the program cannot begin in the present state."""
        _ = application.controller.state  # without a controller, that is the cause
        for need in self.needs:
            need(application, self.name, settings)


def by_name(programs: Iterable[Program[Any, Any]]) -> dict[str, Program[Any, Any]]:
    """The programs by name. Raises ConfigurationError (``configuration.program_twice``) for a name taken."""
    table: dict[str, Program[Any, Any]] = {}
    for program in programs:
        if program.name in table:
            raise ConfigurationError("configuration.program_twice", f"two programs are named {program.name}")
        table[program.name] = program
    return table
