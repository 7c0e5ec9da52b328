"""The fault cases' bench in simulated time: lockstep's world with its plant behind a coupler."""

from functools import cache

from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import Acknowledgement, Command, ReferencePath, ReferencePose, State
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import Wire, World
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from tests.faults.registers import Registers, assert_shut
from tests.support.paths import CONFIGS

MS = 1_000_000
CLOSING_NS = 120 * MS  # from the centred word to the shut spool: delay, servo valve, and its last per mille


@cache
def settings_of(seed: int, assignments: tuple[str, ...]) -> Settings:
    """The settings of the standard world of ``seed``; parsed once, for that takes longer than most cases."""
    return load_settings(CONFIGS, chosen_overrides(CONFIGS, "standard", seed, list(assignments)))


class FaultRig:
    """World, registers and vision's session, connected over ``wire``; ``assignments`` as for ``--set``."""

    def __init__(self, *assignments: str, seed: int = 1, wire: Wire = list) -> None:
        self.world = World(settings_of(seed, assignments), seed, RunLog())
        self.registers = Registers(self.world.plant)
        self.world.plant = self.registers  # type: ignore[assignment]
        self.world.to_controller = wire
        self.until(lambda: self.world.link.connected)

    # time
    @property
    def now_ns(self) -> int:
        """The simulated time, which is the plant's."""
        return self.world.time_ns

    def run(self, seconds: float) -> None:
        """Let ``seconds`` pass, in whole cycles."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            self.world.clock.advance()

    def until(self, done: object, limit_s: float = 12.0) -> float:
        """Seconds until ``done()``; asserts that it comes to that."""
        began_ns = self.now_ns
        while not done():  # type: ignore[operator]
            assert self.now_ns - began_ns < limit_s * 1e9, "did not happen in time"
            self.world.clock.advance()
        return (self.now_ns - began_ns) / 1e9

    # vision's side
    @property
    def state(self) -> State:
        """The newest state that came."""
        return self.world.states[-1]

    def ask(self, request: Command | ReferencePose | ReferencePath) -> Acknowledgement:
        """The answer to a request."""
        return run(self.world.link.answer(self.world.link.submit(request)))

    def command(self, code: CommandCode) -> Reason:
        """The reason that answers a command."""
        return self.ask(Command(0, code)).reason

    def shifted(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
        """The commanded pose of the tool, moved (m, in B)."""
        here = self.state.X_BT_cmd
        return Pose((here.p_m[0] + x, here.p_m[1] + y, here.p_m[2] + z), here.q_wxyz)

    def enabled(self) -> "FaultRig":
        """This rig, in standby."""
        assert self.command(CommandCode.ENABLE) is Reason.ACCEPTED
        self.until(lambda: self.state.group_state is GroupState.STANDBY)
        self.run(0.1)
        return self

    def moving(self) -> "FaultRig":
        """This rig in the middle of a motion of half a metre with at least three valves open."""
        self.enabled()
        goal = self.shifted(x=-0.2, y=0.4, z=0.2)
        assert self.ask(ReferencePose(0, goal, 0.0)).reason is Reason.ACCEPTED
        self.run(0.8)
        assert sum(abs(valve) > 0.01 for valve in self.registers.written[-1].image.valves) >= 3
        return self

    @property
    def arrived(self) -> bool:
        """Whether the last motion has ended."""
        return self.state.motion_done

    def reconnect(self, nonce: int = 99) -> None:
        """A new run of the client, on a sound wire, with a session of its own."""
        world = self.world
        world.to_controller = world.to_vision = list
        world.open_link(nonce)
        self.until(lambda: world.link.connected, 2.0)

    def assert_safe(self, fault: FaultCode, since_ns: int, within_s: float) -> None:
        """Asserts SAFE: centred, enable dropped, spools shut; latched with its cause; nothing resumes."""
        limit_ns = since_ns + round(within_s * 1e9)
        assert self.now_ns > limit_ns + CLOSING_NS, "nothing can be said so early"
        assert_shut(self.registers, limit_ns + CLOSING_NS)
        late = [
            r for r in self.registers.written if r.time_ns > limit_ns and (r.image.control & 1 or r.drives)
        ]
        assert not late, f"{(late[-1].time_ns - since_ns) / 1e6} ms after the fault: {late[-1]}"
        if not self.world.link.connected:
            self.reconnect()
        self.run(0.5)
        assert (self.state.group_state, self.state.fault) == (GroupState.ERROR_STOP, fault)
        assert self.state.severity in (Severity.STOP, Severity.EMERGENCY)
        assert self.ask(ReferencePose(0, self.shifted(z=0.05), 0.0)).reason is Reason.ERROR_LATCHED
        assert self.command(CommandCode.ENABLE) is Reason.ERROR_LATCHED
        assert_shut(self.registers, limit_ns + CLOSING_NS)

    def assert_completes(self, limit_s: float = 12.0) -> None:
        """Asserts that the motion goes on to its end, without a fault."""
        self.until(lambda: self.arrived, limit_s)
        assert (self.state.group_state, self.state.fault) == (GroupState.STANDBY, FaultCode.NONE)
