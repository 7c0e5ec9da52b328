"""A row of targets, one after the other, with one local track."""

from typing import Annotated, NamedTuple

from pydantic import Field

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import LookThenMoveSettings, body_of
from vision_pc.application.program import MOVING, Program
from vision_pc.application.results import JSON, positioning_json
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.local_error_model import LocalTrack, record_local_track
from vision_pc.core.ports import Report
from vision_pc.core.positioning.corrected_positioning import CorrectedResult, look_then_move_corrected

Id = Annotated[str, Field(max_length=20)]


class VisitSettings(LookThenMoveSettings):
    """The targets in their order (none: all), and how each is driven to."""

    targets: Annotated[tuple[Id, ...], Field(min_length=1, max_length=100)] | None = Field(
        None, examples=[["t1", "t2"]], description="Left out: all, oldest first"
    )


class Visited(NamedTuple):
    """One target: its id, how it is known at the end, how the tool came there, whether a track was made."""

    target: str
    known: str
    way_m: float
    calibrated: bool
    result: CorrectedResult


async def visit(
    application: VisionApplication, settings: VisitSettings, report: Report
) -> tuple[Visited, ...]:
    """Drive to each target in turn by corrected positioning; where the model no longer knows its goal well
    enough a new local track is recorded, once for each target. The last target stays aimed at.
    """
    application.positioning = settings
    visited: list[Visited] = []
    row = _row(application, settings)
    for number, target in enumerate(row):

        def report_share(progress: float, note: str, number: int = number, target: str = target) -> None:
            report((number + progress) / len(row), f"{target}: {note}")

        application.camera.targets.aim(target)
        calibrated = application.track is None
        try:
            result = await drive_corrected(application, settings, report_share)
        except MeasurementFailed as error:
            if calibrated or error.cause != "measurement.ill_conditioned":
                raise
            calibrated, application.track = True, None
            result = await drive_corrected(application, settings, report_share)
        kept = application.camera.targets.get(target)
        visited.append(Visited(target, kept.known, kept.way_m, calibrated, result))
    return tuple(visited)


async def drive_corrected(
    application: VisionApplication, settings: LookThenMoveSettings, report: Report
) -> CorrectedResult:
    """Drive by corrected positioning; the track, made where there is none, holds for the next."""
    track, application.track = application.track, None  # a motion that fails leaves a gap in it
    map_settings = application.settings.local_map
    if track is None:
        track = await new_track(application, map_settings, report)
    arm, eyes, boom = application.arm, application.eyes, application.dimensions
    result = await look_then_move_corrected(arm, eyes, report, settings, map_settings, boom, track)
    application.track = result.track
    application.doubt(result.positioning.contradiction)
    return result


async def new_track(
    application: VisionApplication, settings: LocalErrorModelSettings, report: Report
) -> LocalTrack:
    """A local track recorded here; an object that stood still along it ends a doubt."""
    arm, eyes = application.arm, application.eyes
    track = await record_local_track(arm, eyes, report, settings, application.dimensions)
    if track.object_stands:
        application.trust("calibration")
    return track


def _row(application: VisionApplication, settings: VisitSettings) -> tuple[Id, ...]:
    return settings.targets or tuple(kept.id for kept in application.camera.targets.list())


def known_targets(application: VisionApplication, name: str, settings: VisitSettings) -> None:
    """All of the targets that are named."""
    row = _row(application, settings)
    if not row:
        raise RequestRefused("refused.unknown_target", f"{name}: there are no targets")
    for target in row:
        if application.camera.targets.get(target).known == "lost":
            raise RequestRefused("refused.target_lost", f"{name}: {target} was lost; click it again")


def visit_json(visited: tuple[Visited, ...]) -> JSON:
    """Every target with its drive."""
    return {
        "targets": [
            {
                "target": each.target,
                "known": each.known,
                "carried_mm": round(1e3 * each.way_m, 1),
                "calibrated": each.calibrated,
            }
            | positioning_json(each.result)
            for each in visited
        ]
    }


VISIT = Program(
    "visit",
    "Drive to a row of targets, one after the other",
    run=visit,
    to_json=visit_json,
    body=body_of(VisitSettings, "clearance_m", "tolerance_mm", "corrections", "targets"),
    settings=lambda application: VisitSettings(**application.settings.positioning.model_dump()),
    needs=(*MOVING, known_targets),
    core=look_then_move_corrected,
    source="`application/visit.py` (docs/targets.md)",
)
