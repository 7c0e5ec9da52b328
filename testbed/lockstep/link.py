"""Arm and eyes in lockstep: the programs' two ports, implemented by letting simulated time pass.

Nothing here waits for the outside, so a program runs to its end without an event loop.
"""

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from protocol.channel import LinkStatistics
from protocol.clock_offset import OffsetEstimate
from protocol.errors import LinkLost
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Acknowledgement, Command, Request, State, StreamedPose, StreamRefused
from testbed.lockstep.world import World
from vision_pc.core.se3 import Array
from vision_pc.shell.link.controller_link import pose_between, refusal

T = TypeVar("T")

_STATE_TIMEOUT_NS = 1_000_000_000
_ANSWER_TIMEOUT_NS = 2_000_000_000


def run(program: Coroutine[Any, Any, T]) -> T:
    """The result of ``program``, none of whose awaits waits for the outside."""
    try:
        program.send(None)
    except StopIteration as done:
        result: T = done.value
        return result
    raise RuntimeError("a program in lockstep waited for something outside of simulated time")


class LockstepLink:
    """Vision's end of the reference link as its arm uses it; ``ControllerLink``'s methods over the world."""

    def __init__(self, world: World) -> None:
        self._world = world

    @property
    def connected(self) -> bool:
        """Whether a session is open and a state has come in it."""
        return self._world.connected

    @property
    def state(self) -> State:
        """The newest state. Raises LinkLost when there is no session."""
        if not self.connected:
            raise LinkLost("link.not_connected", "controller does not answer")
        return self._world.states[-1]

    @property
    def clock_offset(self) -> OffsetEstimate | None:
        """The controller's clock minus vision's, with its bound."""
        return self._world.clock

    @property
    def state_age_ns(self) -> int:
        """Since the newest state was received; in lockstep it comes when it is sent."""
        return self._world.vision_ns - self.local_time_ns(self.state.time_ns)

    @property
    def authenticated(self) -> bool:
        """Whether every datagram of the session is signed."""
        return self._world.authenticated

    @property
    def statistics(self) -> LinkStatistics:
        """Counters of vision's session."""
        return self._world.link_statistics

    def local_time_ns(self, controller_ns: int) -> int:
        """A time of the controller's clock on vision's."""
        clock = self._world.clock
        return controller_ns - (clock.offset_ns if clock else 0)

    async def next_state(self) -> State:
        """The next state to come. Raises LinkLost when none comes in time."""
        known = len(self._world.states)
        self._until(lambda: len(self._world.states) > known, _STATE_TIMEOUT_NS, "link.silent", "state")
        return self.state

    @property
    def known_until_ns(self) -> int:
        """The newest state's time on vision's clock."""
        return self.local_time_ns(self.state.time_ns)

    async def pose_at(self, local_ns: int) -> Array:
        """X_BT (4×4) at ``local_ns`` of vision's clock, interpolated; waits for the state after it."""
        while self.known_until_ns < local_ns:
            await self.next_state()
        return self.pose_known_at(local_ns)

    def pose_known_at(self, local_ns: int) -> Array:
        """X_BT (4×4) at a time on vision's clock that the newest state has reached.

        Raises LinkLost when it is older than the first state.
        """
        wanted = local_ns - self.local_time_ns(0)
        states = self._world.states
        newer = states[-1]
        for older in reversed(states):
            if older.time_ns <= wanted:
                return pose_between(older, newer, wanted)
            newer = older
        raise LinkLost("link.state_too_old", "the pose asked for is older than the first state")

    async def command(self, code: CommandCode) -> Acknowledgement:
        """The acknowledgement of a command. Raises RequestRefused or LinkLost."""
        return await self.request(Command(0, code))

    @property
    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self._world.vision_ns

    def stream(self, reference: StreamedPose) -> None:
        """Sends a streamed reference with the next cycle. Raises LinkLost."""
        self._world.stream(reference)

    def refusal_of(self, stream_id: int) -> StreamRefused | None:
        """The first refusal of a reference of this stream."""
        return self._world.refusals.get(stream_id)

    async def request(self, request: Request) -> Acknowledgement:
        """The acknowledgement of any request. Raises RequestRefused or LinkLost."""
        answers = self._world.acknowledgements
        command_id = self._world.submit(request)
        self._until(lambda: command_id in answers, _ANSWER_TIMEOUT_NS, "link.unanswered", "acknowledgement")
        answer = answers[command_id]
        already = isinstance(request, Command) and answer.reason is Reason.ALREADY_DONE
        if answer.reason is not Reason.ACCEPTED and not already:
            raise refusal(request, answer)
        return answer

    def _until(self, done: Callable[[], bool], timeout_ns: int, cause: str, what: str) -> None:
        deadline_ns = self._world.time_ns + timeout_ns
        while not done():
            if self._world.link_lost is not None:
                reason = self._world.link_lost.reason.name.lower()
                raise LinkLost(f"link.{reason}", f"controller: {reason.replace('_', ' ')}")
            if self._world.time_ns >= deadline_ns:
                raise LinkLost(cause, f"no {what} from the controller within {timeout_ns / 1e9:g} s")
            self._world.step()
