"""A controller for the suite to ask: the real session and scan, and an obedient plant."""

import select
import socket
import threading
import time
from functools import cache
from typing import Any, ClassVar, Self

from conformance.case import CaseOutcome, Summary
from controller.config import ControllerConfig
from controller.core.inbox import Inbox
from controller.core.settings import ScanSettings, settings_from
from controller.shell.cyclic_task import warm_up
from foundation.configuration import configuration_hash, load, merged, parse_overrides
from nominal_arm.description import NominalArm
from protocol.authentication import LinkKey
from protocol.process_image import CONTROL_ENABLE
from protocol.reference_messages import Acknowledgement, Request, State
from protocol.server_session import ReferenceServer
from protocol.session_events import RequestReceived, ServerEvent, StreamedPoseReceived
from tests.conformance.simulated_network import SimulatedNetwork, SimulatedSocket
from tests.controller.obedient_plant import Bench
from tests.support.paths import CONFIGS

LINK_TIMEOUT_MS = 200
OVERRIDES = ["controller.supervision.overrun_ms=2000"]
# On real sockets; in simulated time nothing is late.
PATIENT = "controller.streaming.silence_ms=200"
# What the lift sinks by while its valve is centred (rad/s): the command has something to follow.
CREEP_RAD_S = -5e-4


@cache
def settings(*more: str) -> ScanSettings:
    """The shipped configuration, tolerant of a test machine's lateness, with further overrides."""
    arm = load(NominalArm, CONFIGS / "arm.yaml")
    overrides = merged(parse_overrides(OVERRIDES), parse_overrides(more))["controller"]
    config = load(ControllerConfig, CONFIGS / "controller.yaml", overrides)
    return settings_from(arm, config)


@cache
def warmed_up() -> None:
    """Once a process: the kernels are there before a link timeout of 200 ms counts."""
    warm_up(settings())


@cache
def shipped_arm_hash() -> int:
    return configuration_hash(load(NominalArm, CONFIGS / "arm.yaml"))


def _real_socket() -> socket.socket:
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    bound.bind(("127.0.0.1", 0))
    bound.setblocking(False)
    return bound


def not_passed(summary: Summary) -> dict[int, str]:
    """What did not pass, and why."""
    return {
        r.case.number: f"{r.outcome.value}: {r.detail}"
        for r in summary.results
        if r.outcome is not CaseOutcome.PASS
    }


class ControllerUnderTest:
    """Serves the reference link on a free port of loopback, in a thread of its own, until it is left.

    With a ``network`` it serves there, in simulated time and without a thread. A mutant overrides one of the
    hooks ``make_server``, ``incoming``, ``judge``, ``shown``, ``outgoing``.
    """

    link_key: LinkKey | None = None
    network: ClassVar[SimulatedNetwork | None] = None

    def __init__(self) -> None:
        warmed_up()
        self.settings = self.configured()
        self.cycle_ns = round(self.settings.cycle_s * 1e9)
        self.bench = Bench(self.settings)
        self.bench.step()
        self.server = self.make_server()
        self.inbox = self.make_inbox()
        self._clock_ns = self.network.clock_ns if self.network else time.monotonic_ns
        self._socket: Any = SimulatedSocket(self.network) if self.network else _real_socket()
        self.port: int = self._socket.getsockname()[1]
        self.next_ns = self._clock_ns()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self.failure: BaseException | None = None

    def configured(self) -> ScanSettings:
        """The settings of the scan."""
        return settings() if self.network else settings(PATIENT)

    def make_server(self) -> ReferenceServer:
        """The server's end of the link."""
        return ReferenceServer(77, shipped_arm_hash(), self.cycle_ns, LINK_TIMEOUT_MS, key=self.link_key)

    def make_inbox(self) -> Inbox:
        """What holds the requests until the scan."""
        return Inbox()

    def incoming(self, data: bytes) -> bytes | None:
        """A datagram as the controller takes it in."""
        return data

    def judge(self, request: Request) -> Request:
        """A request as the scan gets it."""
        return request

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        """A streamed reference as the scan gets it."""
        return arrival

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        """What is sent for one answer of the scan."""
        return [acknowledgement]

    def shown(self, state: State) -> State:
        """A state as it is published."""
        return state

    def outgoing(self, data: bytes) -> list[bytes]:
        """What is sent for one datagram of the server."""
        return [data]

    def __enter__(self) -> Self:
        if self.network:
            self.network.controllers.append(self)
        else:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.network:
            self.network.controllers.remove(self)
        else:
            self._ending.set()
            self._thread.join(5.0)
        self._socket.close()
        if self.failure is not None:
            raise self.failure

    def _serve(self) -> None:
        try:
            while not self._ending.is_set():
                left_s = max(self.next_ns - time.monotonic_ns(), 0) / 1e9
                select.select([self._socket], [], [], left_s)
                self.turn()
        except BaseException as failure:
            self.failure = failure

    def turn(self) -> None:
        """Read what has come, scan if a scan is due, and send."""
        self._read()
        now_ns = self._clock_ns()
        if now_ns >= self.next_ns:
            self._scan()
            self.next_ns = max(self.next_ns + self.cycle_ns, now_ns)
        self._send()

    def _read(self) -> None:
        batch = []
        for _ in range(64):
            try:
                data, source = self._socket.recvfrom(65_535)
            except BlockingIOError:
                break
            taken = self.incoming(data)
            if taken is not None:
                batch.append((taken, source))
        if batch:
            self._note(self.server.receive_batch(batch, self._clock_ns()))

    def _note(self, events: list[ServerEvent]) -> None:
        for answer in self.inbox.put([self._judged(event) for event in events]):
            self.server.acknowledge(answer, self._clock_ns())

    def _judged(self, event: ServerEvent) -> ServerEvent:
        if isinstance(event, RequestReceived):
            return RequestReceived(self.judge(event.message))
        return self.judge_streamed(event) if isinstance(event, StreamedPoseReceived) else event

    def _scan(self) -> None:
        now_ns = self._clock_ns()
        self._note(self.server.tick(now_ns))
        requests, self.bench.link_alive = self.inbox.take(self.server.link_alive(now_ns))
        self.bench.now_ns = now_ns - self.cycle_ns  # the bench adds one cycle
        self._creep()
        output = self.bench.step(*requests, arrival=self.inbox.take_streamed())
        if output.refusal is not None:
            self.server.refuse_streamed(output.refusal, now_ns)
        del self.bench.outputs[:-1]
        for acknowledgement in output.acknowledgements:
            for each in self.answered(acknowledgement):
                self.server.acknowledge(each, now_ns)
        tally = self.server.statistics
        state = State(
            **output.view._asdict(),
            overruns=3,
            lateness_p50_us=40,
            lateness_p99_us=90,
            lateness_max_us=400,
            references_lost=tally.lost,
            references_dropped=tally.dropped,
        )
        self.server.publish(self.shown(state), now_ns)

    def _creep(self) -> None:
        if not self.bench.last.valves.control & CONTROL_ENABLE:
            slew, lift, *others = self.bench.q
            self.bench.q = (slew, lift + CREEP_RAD_S * self.settings.cycle_s, *others)

    def _send(self) -> None:
        for data, source in self.server.outgoing(self._clock_ns()):
            for each in self.outgoing(data):
                self._socket.sendto(each, source)
