"""Guided hand-eye calibration as programs: the rows of its long steps."""

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from pydantic import Field

from foundation.configuration import validated
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import Own, RequestBody, body_of
from vision_pc.application.hand_eye.guided_calibration import GuidedCalibration
from vision_pc.application.hand_eye.responses import (
    arrival_json,
    next_json,
    sample_json,
    solved_json,
    start_json,
    targets_json,
)
from vision_pc.application.program import MOVING, STANDING, Need, Program
from vision_pc.application.results import JSON
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core.ports import Report

T = TypeVar("T")
HAND_EYE = "hand-eye"
"""Tag of these programs: they are there when the application has a guided session."""


class StartSettings(GuidedSettings):
    """A new session: its name, the seed of its proposals, and the session's own settings."""

    name: str = ""
    seed: int = 1

    @property
    def session(self) -> GuidedSettings:
        """The session's own settings."""
        return validated(GuidedSettings, self.model_dump(exclude={"name", "seed"}), "request")


StartBody = body_of(
    "StartBody",
    "A new session; what is not given is as configured.",
    GuidedSettings,
    name=Own(str, Field(examples=["monday"], min_length=1, max_length=64)),
    marker_id=582,
    marker_size_m=0.05,
    poses=17,
    seed=Own(int, Field(1, ge=0, le=2**31, description="The same seed proposes among the same views")),
)


class NextBody(RequestBody):
    """``informative`` false: any pose that keeps the bounds, for comparison."""

    informative: bool = True


class RedoBody(RequestBody):
    """The sample to take again at its own pose."""

    sample: str = Field(examples=["3"], min_length=1, max_length=64)


class EmptyBody(RequestBody):
    """Nothing needs to be said."""


def _row(
    name: str,
    title: str,
    run: Callable[[VisionApplication, Any, Report], Coroutine[Any, Any, T]],
    to_json: Callable[[T], JSON],
    needs: tuple[Need, ...],
    body: type[RequestBody] = EmptyBody,
    settings: Callable[[VisionApplication], Any] | None = None,
) -> Program[Any, T]:
    """The row of one step of the session; its core is the step of that name."""
    core = getattr(GuidedCalibration, name, GuidedCalibration.next_pose)
    return Program(
        f"{HAND_EYE}-{name}", title, run, to_json, body, settings, needs, core, "docs/hand_eye.md", HAND_EYE
    )


HAND_EYE_PROGRAMS = (
    _row(
        "start",
        "Check the starting pose and open a session",
        lambda app, asked, report: app.guided.start(asked.name, asked.session, asked.seed, report),
        start_json,
        STANDING,
        StartBody,
        lambda app: StartSettings(**app.guided.defaults.model_dump()),
    ),
    _row(
        "go", "Drive to the proposed pose", lambda app, _, report: app.guided.go(report), arrival_json, MOVING
    ),
    _row(
        "next",
        "Propose and drive until the controller accepts a pose",
        lambda app, asked, report: app.guided.next_pose(report, asked.informative),
        next_json,
        MOVING,
        NextBody,
    ),
    _row(
        "back",
        "Drive back to the starting pose, over the samples where need be",
        lambda app, _, report: app.guided.back(report),
        arrival_json,
        MOVING,
    ),
    _row(
        "sample",
        "Take a sample where the arm stands, once it has settled",
        lambda app, _, report: app.guided.sample(report),
        sample_json,
        STANDING,
    ),
    _row(
        "redo",
        "Drive back to a sample's pose and take it again",
        lambda app, asked, report: app.guided.redo(asked.sample, report),
        sample_json,
        MOVING,
        RedoBody,
    ),
    _row(
        "locate",
        "Knob, switch and key hole of the cabinet, in hand and base",
        lambda app, _, report: app.guided.locate(report),
        targets_json,
        STANDING,
    ),
    _row(
        "solve",
        "X with covariance, residuals, proof and verdict",
        lambda app, _, _report: app.guided.solve(),
        solved_json,
        STANDING,
    ),
)
