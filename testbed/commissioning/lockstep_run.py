"""The excitation of joints in lockstep: the shipped controller, in its excitation mode, on the plant."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from controller.core.excitation.plan import Stroke, Trouble
from protocol.errors import LinkLost, MeasurementFailed
from protocol.faults import CommandCode, GroupState
from testbed.commissioning.recording import JointRecording, SeenPose, recording_of
from testbed.lockstep.clock import run
from testbed.lockstep.world import World
from testbed.scenarios.settings import Settings
from vision_pc.core.ports import Eyes
from vision_pc.core.types import WatchSample

_LONGEST_S = 3600.0


class Excited(NamedTuple):
    """How an excitation ended: arm time (s), and what broke it off."""

    seconds: float
    trouble: Trouble | None


def with_excitation(settings: Settings, joints: Sequence[int]) -> Settings:
    """``settings`` whose controller starts in the excitation mode, for these joints in this order."""
    mode = settings.controller.excitation.model_copy(update={"enabled": True, "joints": tuple(joints)})
    return settings._replace(controller=settings.controller.model_copy(update={"excitation": mode}))


def excite_in_lockstep(
    world: World,
    keep: Callable[[JointRecording], None],
    progress: Callable[[float, str], None],
    eyes: Eyes | None = None,
) -> Excited:
    """Enable the arm of ``world`` and let its joints be tried out; ``keep`` gets each that is finished.

    ``eyes``: whose odometry watches meanwhile. Raises MeasurementFailed (``measurement.stopped``) when
    somebody else stopped the arm, LinkLost when the reference link does not open.
    """
    world.connect()
    if not world.connected:
        raise LinkLost("link.controller_missing", "the controller does not answer")
    if eyes is None:
        return _excited(world, keep, progress, tuple)
    return run(_watched(world, keep, progress, eyes))


async def _watched(
    world: World, keep: Callable[[JointRecording], None], progress: Callable[[float, str], None], eyes: Eyes
) -> Excited:
    """As ``_excited``; odometry that saw nothing at all does not spoil what the valves said."""
    done: Excited | None = None
    try:
        async with eyes.watch(markers=False, odometry=True) as watch:
            offset_ns = world.link.local_time_ns(0)
            done = _excited(world, keep, progress, lambda: _seen(watch.samples, offset_ns))
    except MeasurementFailed:
        if done is None:
            raise
    return done


def _seen(samples: Sequence[WatchSample], offset_ns: int) -> list[SeenPose]:
    """The poses that odometry found, on the controller's clock."""
    return [SeenPose(s.time_ns - offset_ns, s.X_C0C) for s in samples if s.X_C0C is not None]


def _excited(
    world: World,
    keep: Callable[[JointRecording], None],
    progress: Callable[[float, str], None],
    seen: Callable[[], Sequence[SeenPose]],
) -> Excited:
    controller, plan = world.controller, world.controller.plan
    assert plan is not None  # with_excitation
    run(world.link.command(CommandCode.ENABLE))
    began_ns, kept = world.time_ns, 0
    while True:
        world.clock.advance()
        program = controller.excitation
        while kept < program.stroke:
            joint = plan.strokes[kept].joint
            keep(recording_of(world.settings.arm, joint, plan.strokes, controller.samples, seen()))
            kept = _after(plan.strokes, kept)
            progress(kept / len(plan.strokes), f"{1e-9 * (world.time_ns - began_ns):.0f} s of arm time")
        seconds = 1e-9 * (world.time_ns - began_ns)
        if program.finished(plan) or program.trouble is not None:
            _rest(world)
            return Excited(seconds, program.trouble)
        if program.excitation is None and program.inner.fault.code:
            fault = program.inner.fault
            _rest(world)
            raise MeasurementFailed(
                "measurement.stopped", f"fault {fault.code.name.lower()} after {seconds:.1f} s"
            )
        if seconds > _LONGEST_S:
            raise MeasurementFailed("measurement.stopped", f"no end after {seconds:.0f} s")


def _after(strokes: Sequence[Stroke], index: int) -> int:
    """The first stroke of the next joint."""
    joint = strokes[index].joint
    while index < len(strokes) and strokes[index].joint == joint:
        index += 1
    return index


def _rest(world: World) -> None:
    """Until the group stands, its valves centred; then it is disabled."""
    world.clock.advance_until(lambda: world.states[-1].group_state is not GroupState.MOVING, 2.0)
    run(world.link.command(CommandCode.DISABLE))
    world.clock.advance()
