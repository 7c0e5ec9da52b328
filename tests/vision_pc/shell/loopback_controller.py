"""A controller on a real UDP socket for tests: the protocol's server session over the synthetic arm.

Its group states are the simplest that fit the link's contract; its motion is exact in the nominal model.
What it says and refuses follows from its state, so that links, operations and the REST face are tried
against behaviour.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from protocol.authentication import LinkKey
from protocol.errors import RequestRefused
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    CAPABILITY_VALVE_TRIALS,
    FLAG_EMERGENCY_LATCHED,
    FLAG_PLANT_LINK_OK,
    FLAG_SETTLED,
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    State,
)
from protocol.server_session import ReferenceServer
from protocol.session_events import RequestReceived, SessionClosed
from tests.vision_pc.synthetic import SyntheticRig, forward, inverse_kinematics
from vision_pc.core.se3 import Array, from_pose, local, retract, to_pose

CYCLE_S = 0.01
SWING_CYCLES = 20


async def until(condition: Callable[[], object], limit_s: float = 30.0) -> None:
    """Waits for ``condition``; fails the test when it does not come true in time."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "did not happen in time"
        await asyncio.sleep(0.005)


class LoopbackController(asyncio.DatagramProtocol):
    """Serves on 127.0.0.1 at ``port`` (0: any) from ``start`` to ``stop``; ``speed`` in m/s."""

    def __init__(
        self,
        rig: SyntheticRig,
        speed: float = 1.5,
        clock_ahead_ns: int = 7_000_000_000,
        key: LinkKey | None = None,
        link_timeout_ms: int = 500,
        capabilities: int = CAPABILITY_PATHS | CAPABILITY_STREAMING,
    ) -> None:
        self.rig, self.speed, self.clock_ahead_ns = rig, speed, clock_ahead_ns
        self.session = ReferenceServer(
            1, 0xA12, int(CYCLE_S * 1e9), link_timeout_ms, capabilities=capabilities, key=key
        )
        self._tries_valves = bool(capabilities & CAPABILITY_VALVE_TRIALS)
        self.group, self.fault, self.emergency = GroupState.DISABLED, FaultCode.NONE, False
        self.motion: list[tuple[Array, Array, int]] = []  # X_from, X_goal, cycles
        self.motion_id, self.motion_done, self.cycle, self.step = 0, False, 0, 0
        self.never_settles, self.swing_rad = False, 0.0
        self.muted = False
        self.requests: list[Any] = []
        self.port = 0
        self._transport: asyncio.DatagramTransport | None = None
        self._task: asyncio.Task[None] | None = None

    def now_ns(self) -> int:
        """The controller's own clock: ahead of everybody else's."""
        return time.monotonic_ns() + self.clock_ahead_ns

    async def start(self, port: int = 0, address: str = "127.0.0.1") -> None:
        loop = asyncio.get_running_loop()
        self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(address, port))
        self.port = self._transport.get_extra_info("sockname")[1]
        self._task = asyncio.create_task(self._run())

    async def stop(self, *, say_goodbye: bool = True) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])
        if self._transport is not None and not self._transport.is_closing():
            if say_goodbye:
                self.session.close(self.now_ns())
                self._send()
            self._transport.close()

    def break_down(self, fault: FaultCode) -> None:
        """A fault: the group goes to ERROR_STOP where it stands."""
        self.group, self.fault, self.motion = GroupState.ERROR_STOP, fault, []

    # the link
    def datagram_received(self, data: bytes, addr: Any) -> None:
        if self.muted:
            return
        for event in self.session.receive(data, addr, self.now_ns()):
            if isinstance(event, RequestReceived):
                self.requests.append(event.message)
                reason, value = self._decide(event.message)
                answer = Acknowledgement(event.message.command_id, reason, value, 0.0)
                self.session.acknowledge(answer, self.now_ns())
            elif isinstance(event, SessionClosed) and self.group is GroupState.MOVING:
                self._halt()
        self._send()

    def _send(self) -> None:
        assert self._transport is not None
        if self.muted:
            return
        for datagram, addr in self.session.outgoing(self.now_ns()):
            self._transport.sendto(datagram, addr)

    # the group
    def _decide(self, request: Command | ReferencePose | ReferencePath) -> tuple[Reason, float]:
        if isinstance(request, Command):
            return self._command(request.code), 0.0
        if self.emergency:
            return Reason.EMERGENCY_LATCHED, 0.0
        if self.group is GroupState.ERROR_STOP:
            return Reason.ERROR_LATCHED, 0.0
        if self.group is GroupState.DISABLED:
            return Reason.DISABLED, 0.0
        poses = request.waypoints if isinstance(request, ReferencePath) else (request.X_BT_ref,)
        dwell_s = request.dwell_s if isinstance(request, ReferencePath) else 0.0
        return self._begin(request.command_id, [from_pose(pose) for pose in poses], dwell_s)

    def _begin(self, command_id: int, waypoints: Sequence[Array], dwell_s: float) -> tuple[Reason, float]:
        X, q = forward(self.rig.q), self.rig.q
        motion = []
        for X_goal in waypoints:
            try:
                q = inverse_kinematics(X_goal, q)
            except RequestRefused:
                return Reason.UNREACHABLE, float(np.linalg.norm(X_goal[:3, 3]))
            way = float(np.linalg.norm(local(X, X_goal)))
            motion.append((X, X_goal, max(int(way / self.speed / CYCLE_S), 5)))
            motion.append((X_goal, X_goal, max(int(dwell_s / CYCLE_S), 1)))
            X = X_goal
        self.motion, self.step = motion, 0
        self.motion_id, self.motion_done, self.group = command_id, False, GroupState.MOVING
        return Reason.ACCEPTED, 0.0

    def _command(self, code: CommandCode) -> Reason:
        if code is CommandCode.STOP:
            self._halt()
        elif code is CommandCode.EMERGENCY_STOP:
            self.emergency = True
            self.break_down(FaultCode.EMERGENCY_STOP)
        elif code is CommandCode.EMERGENCY_RELEASE:
            self.emergency = False
        elif self.emergency:
            return Reason.EMERGENCY_LATCHED
        elif code is CommandCode.RESET:
            if self.group is not GroupState.ERROR_STOP:
                return Reason.NOT_IN_ERROR
            self.group, self.fault = GroupState.DISABLED, FaultCode.NONE
        elif self.group is GroupState.ERROR_STOP:
            return Reason.ERROR_LATCHED
        elif code is CommandCode.ENABLE:
            if self.group is not GroupState.DISABLED:
                return Reason.ALREADY_DONE
            self.group = GroupState.STANDBY
            if self._tries_valves:  # for as long as nobody stops it
                X = forward(self.rig.q)
                self.motion, self.step, self.group = [(X, X, 10**9)], 0, GroupState.MOVING
        else:
            self.motion, self.group = [], GroupState.DISABLED
        return Reason.ACCEPTED

    def _halt(self) -> None:
        if self.group is GroupState.MOVING:
            self.motion, self.group, self.step = [], GroupState.STOPPING, 0

    # time
    async def _run(self) -> None:
        while True:
            await asyncio.sleep(CYCLE_S)
            self.session.tick(self.now_ns())
            self._cycle()
            self.session.publish(self.state(), self.now_ns())
            self._send()

    def _cycle(self) -> None:
        self.cycle += 1
        self.step += 1
        if self.group is GroupState.STOPPING and self.step > 5:
            self.group, self.motion_done = GroupState.STANDBY, True
        q = self.rig.q
        if self.group is GroupState.MOVING:
            X_from, X_goal, cycles = self.motion[0]
            u = min(self.step / cycles, 1.0)
            u = u * u * u * (10.0 + u * (6.0 * u - 15.0))
            q = inverse_kinematics(retract(X_from, u * local(X_from, X_goal)), q)
            if self.step >= cycles:
                self.motion.pop(0)
                self.step = 0
            if not self.motion:
                self.group, self.motion_done = GroupState.STANDBY, True
        self.rig.advance(q)

    def state(self) -> State:
        """The state as published."""
        settled = self.group is GroupState.STANDBY and not self.never_settles
        flags = FLAG_PLANT_LINK_OK | (FLAG_SETTLED if settled else 0)
        flags |= FLAG_EMERGENCY_LATCHED if self.emergency else 0
        swing = self.swing_rad * (-1.0) ** (self.cycle // SWING_CYCLES)
        q = tuple(float(v) + swing for v in self.rig.q)
        pose = to_pose(forward(self.rig.q))
        severity = Severity.STOP if self.fault is not FaultCode.NONE else Severity.NONE
        return State(
            self.now_ns(), self.cycle, self.group, self.fault, severity, flags, self.motion_id,
            self.motion_done, 0, q, q, (0.0,) * 6, pose, pose, 190.0, 0, 50, 100, 200, 0, 0, 0,
        )  # type: ignore[arg-type]  # fmt: skip
