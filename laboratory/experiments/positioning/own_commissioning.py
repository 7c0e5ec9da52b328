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
from testbed.commissioning.recording import JointRecording
from testbed.commissioning.runs import excite_in_lockstep, with_excitation
from testbed.lockstep.clock import RunLog
from testbed.lockstep.simulated_measurements import EyeCondition, eyes_with, load_eye_model, simulated_sight
from testbed.lockstep.world import World
from testbed.scenarios.scenario import load_settings

_EMPTY = {"plant": {"payload": {"mass_kg": 0.0}}}  # the servo is off meanwhile: a loaded wrist would sink


def own_commissioning(
    config_dir: Path,
    asked: dict[str, Any],
    seed: int,
    condition: EyeCondition,
    joints: Sequence[int] = range(N_JOINTS),
) -> Commissioned:
    """The file that the machine of the overrides ``asked`` makes of itself, its tool empty.

    ``condition``: of the eyes that watch for backlash. Raises MeasurementFailed with the cause that broke the
    trials off, or for which a joint's numbers are refused: as for a user, there is no file then.
    """
    settings = load_settings(config_dir, merged(asked, _EMPTY))
    world = World(with_excitation(settings, joints), seed, RunLog())
    eyes = eyes_with(world, simulated_sight(world, load_eye_model(config_dir, condition), seed))
    recordings: list[JointRecording] = []
    ended = excite_in_lockstep(world, recordings.append, lambda _progress, _note: None, eyes)
    if ended.trouble is not None:
        trouble = ended.trouble
        name = JOINT_NAMES[trouble.joint]
        raise MeasurementFailed(trouble.cause, f"{name}: {trouble.value:.4g}, limit {trouble.limit:.4g}")
    compensated = settings.controller.valves.pressure_compensated
    found = {one.joint: joint_findings(one, compensated) for one in recordings}
    made = datetime.now(UTC).isoformat(timespec="seconds"), f"longreach {version('longreach')}, drawn machine"
    sources = dict.fromkeys(found, f"simulated, seed {seed}")
    return commissioned_from(found, settings.arm, settings.controller, sources, made)
