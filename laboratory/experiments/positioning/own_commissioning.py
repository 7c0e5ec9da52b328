"""A drawn machine that commissions itself: `longreach commission` in simulated time, and its own file."""

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from controller.core.excitation.plan import N_JOINTS
from foundation.configuration import merged
from nominal_arm.commissioned import Commissioned
from nominal_arm.description import JOINT_NAMES
from protocol.errors import MeasurementFailed
from testbed.commissioning.findings import commissioned_from, joint_findings
from testbed.commissioning.recording import JointRecording, recording_of
from testbed.commissioning.runs import excite_in_lockstep, with_excitation
from testbed.lockstep.clock import RunLog
from testbed.lockstep.world import World
from testbed.scenarios.scenario import Settings, load_settings

_EMPTY = {"plant": {"payload": {"mass_kg": 0.0}}}  # the servo is off meanwhile: a loaded wrist would sink


def excited(settings: Settings, joints: Sequence[int], seed: int) -> tuple[list[JointRecording], float]:
    """What was recorded of the trials of ``joints``, and the arm's time for them, s.

    Raises MeasurementFailed with the cause that broke them off.
    """
    world, recordings = World(with_excitation(settings, joints), seed, RunLog()), list[JointRecording]()
    arm_s, failure = excite_in_lockstep(
        world,
        lambda *trial: recordings.append(recording_of(settings.arm, *trial)),
        lambda _progress, _note: None,
    )
    if failure is not None:
        name = JOINT_NAMES[failure.joint]
        raise MeasurementFailed(failure.cause, f"{name}: {failure.value:.4g}, limit {failure.limit:.4g}")
    return recordings, arm_s


def own_commissioning(
    config_dir: Path,
    overrides: dict[str, Any],
    seed: int,
    joints: Sequence[int] = range(N_JOINTS),
) -> Commissioned:
    """The file that the machine of the overrides ``overrides`` makes of itself, its tool empty.

    Raises MeasurementFailed with the cause that broke the trials off, or for which a joint's numbers are
    refused: as for a user, there is no file then.
    """
    settings = load_settings(config_dir, merged(overrides, _EMPTY))
    recordings, _ = excited(settings, joints, seed)
    compensated = settings.controller.valves.pressure_compensated
    found = {one.joint: joint_findings(one, compensated) for one in recordings}
    made = datetime.now(UTC).isoformat(timespec="seconds"), f"longreach {version('longreach')}, drawn machine"
    sources = dict.fromkeys(found, f"simulated, seed {seed}")
    return commissioned_from(found, settings.arm, settings.controller, sources, made)
