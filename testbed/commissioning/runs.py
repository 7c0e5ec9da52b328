"""The excitation of commissioning in lockstep, and what ends it."""

from collections.abc import Callable, Sequence

from controller.core.excitation.plan import Failure, Stroke
from controller.core.excitation.program import ExcitationSample
from protocol.errors import LinkLost, MeasurementFailed
from protocol.faults import CommandCode, GroupState
from testbed.lockstep.clock import run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import Settings

_LONGEST_S = 3600.0
Keep = Callable[[int, Sequence[Stroke], Sequence[ExcitationSample]], None]
"""Gets each joint that is finished, the plan's strokes, and the scans of that joint's."""


def with_excitation(settings: Settings, joints: Sequence[int]) -> Settings:
    """``settings`` whose controller starts in the excitation mode, for these joints in this order."""
    mode = settings.controller.excitation.model_copy(update={"enabled": True, "joints": tuple(joints)})
    return settings._replace(controller=settings.controller.model_copy(update={"excitation": mode}))


def excite_in_lockstep(
    world: World, keep: Keep, progress: Callable[[float, str], None]
) -> tuple[float, Failure | None]:
    """Arm time (s) of trying out the joints of ``world``, which is enabled for it, and what broke it off.

    Raises MeasurementFailed (``measurement.stopped``) when somebody else stopped the arm, LinkLost when the
    reference link does not open.
    """
    world.connect()
    if not world.link.connected:
        raise LinkLost("link.controller_missing", "the controller does not answer")
    controller, plan = world.controller.program, world.controller.program.plan
    assert plan is not None  # with_excitation
    run(world.link.command(CommandCode.ENABLE))
    began_ns, done = world.time_ns, 0
    while True:
        world.clock.advance()
        program = controller.excitation
        while done < program.stroke:
            joint = plan.strokes[done].joint
            keep(joint, plan.strokes, controller.samples)
            controller.samples = []
            done += sum(stroke.joint == joint for stroke in plan.strokes)  # one after the other
            progress(done / len(plan.strokes), f"{1e-9 * (world.time_ns - began_ns):.0f} s of arm time")
        seconds = 1e-9 * (world.time_ns - began_ns)
        if program.finished(plan) or program.failure is not None:
            _rest(world)
            return seconds, program.failure
        if program.excitation is None and program.inner.fault.code:
            fault = program.inner.fault
            _rest(world)
            raise MeasurementFailed(
                "measurement.stopped", f"fault {fault.code.name.lower()} after {seconds:.1f} s"
            )
        if seconds > _LONGEST_S:
            raise MeasurementFailed("measurement.stopped", f"no end after {seconds:.0f} s")


def _rest(world: World) -> None:
    """Until the group stands, its valves centred; then it is disabled."""
    world.clock.advance_until(lambda: world.states[-1].group_state is not GroupState.MOVING, 2.0)
    run(world.link.command(CommandCode.DISABLE))
    world.clock.advance()
