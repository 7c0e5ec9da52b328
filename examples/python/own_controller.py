"""A controller of your own over UDP: a joint law on the emulated oil, driven by vision's end of the link.

Prints what the controller answers, and how far the tool ends from the pose, by the encoders and in truth:
booms bend, and a joint law cannot know. Draws the way there.
"""

import socket
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import longreach
from protocol.client_session import ReferenceClient
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import FLAG_PLANT_LINK_OK, Acknowledgement, Command, ReferencePose, State
from protocol.server_session import ReferenceServer
from protocol.session_events import AcknowledgementReceived, RequestReceived, StateReceived

picture = Path(sys.argv[1] if len(sys.argv) > 1 else "own_controller.png")
CYCLE_NS = 5_000_000
GAIN = np.array(
    [0.8, 1.4, 1.6, 2.0, 2.0, 2.0]
)  # of spool a radian; twice as much, and the boom rocks on its oil
DEADBAND = 0.006  # of spool, on either side of the middle: there no oil flows


def udp() -> socket.socket:
    """A socket on any free port of this machine. On yours: the controller's port is 47000."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind(("127.0.0.1", 0))
    found.settimeout(60.0)
    return found


def heard(end: socket.socket, count: int) -> list[tuple[bytes, tuple[str, int]]]:
    """So many datagrams, and where they come from. Who works in real time reads what waits, and goes on."""
    return [end.recvfrom(2048) for _ in range(count)]


def sent(end: socket.socket, datagrams: list[tuple[bytes, tuple[str, int]]]) -> int:
    """Send them; how many they were."""
    for data, peer in datagrams:
        end.sendto(data, peer)
    return len(datagrams)


class OwnController:
    """The controller's end of the link over your law and your valves: here, those of the emulated plant.

    ``link`` knows sessions, order, repeats and age. Times are given to it, so that this runs as quickly as it
    can; on a real machine they are ``time.monotonic_ns()``, every 5 ms.
    """

    def __init__(self) -> None:
        self.socket = udp()
        self.plant = longreach.plant(seed=1)
        self.arm = longreach.arm()
        self.link = ReferenceServer(boot_id=1, arm_hash=1, cycle_ns=CYCLE_NS, link_timeout_ms=500)
        self.enabled, self.motion, self.number, self.at_rest = False, 0, 0, 0
        self.q = self.encoders(self.plant.step(np.zeros(6)))
        self.goal = self.desired = self.q

    def encoders(self, sensors) -> np.ndarray:
        """Joint angles in rad."""
        return 2 * np.pi / 2**17 * np.array(sensors.encoder_counts)

    def cycle(self, now_ns: int, count: int) -> int:
        """What a PLC does every 5 ms: read, answer, control, tell."""
        for event in self.link.receive_batch(heard(self.socket, count), now_ns):
            if isinstance(event, RequestReceived):
                self.link.acknowledge(self.answer(event.message), now_ns)
        self.desired = self.desired + np.clip(self.goal - self.desired, -5e-4, 5e-4)  # 0.1 rad/s
        left = self.desired - self.q
        valves = self.enabled * np.clip(GAIN * left + DEADBAND * np.tanh(left / 5e-4), -0.8, 0.8)
        sensors = self.plant.step(valves, 1e-9 * CYCLE_NS)
        self.q = self.encoders(sensors)
        self.number += 1
        self.at_rest = self.at_rest + 1 if np.abs(self.goal - self.q).max() < 2e-3 else 0
        self.link.publish(self.state(now_ns, valves, sensors.supply_bar), now_ns)
        return sent(self.socket, self.link.outgoing(now_ns))

    def answer(self, request) -> Acknowledgement:
        """Every request is answered once: done, or refused with value and limit."""
        if isinstance(request, Command):
            self.enabled = request.code is CommandCode.ENABLE  # whatever else there is stops this one
            self.goal = self.desired = self.q
        elif not self.enabled:
            return Acknowledgement(request.command_id, Reason.DISABLED, 0.0, 0.0)
        elif not isinstance(request, ReferencePose):
            return Acknowledgement(request.command_id, Reason.NOT_NEGOTIATED, 0.0, 0.0)
        else:
            X_BT = np.eye(4)
            X_BT[:3, :3] = Rotation.from_quat(request.X_BT_ref.q_wxyz, scalar_first=True).as_matrix()
            X_BT[:3, 3] = request.X_BT_ref.p_m
            self.goal, self.motion, self.at_rest = self.arm.ik(X_BT, near=self.q), request.command_id, 0
        return Acknowledgement(request.command_id, Reason.ACCEPTED, 0.0, 0.0)

    def state(self, now_ns: int, valves: np.ndarray, supply_bar: float) -> State:
        """What vision is told every 20 ms."""
        group = GroupState.STANDBY if self.at_rest > 100 else GroupState.MOVING
        return State(
            now_ns,
            self.number,
            group if self.enabled else GroupState.DISABLED,
            FaultCode.NONE,
            Severity.NONE,
            FLAG_PLANT_LINK_OK,
            self.motion,
            group is GroupState.STANDBY,
            0,
            tuple(self.q),
            tuple(self.desired),
            tuple(valves),
            pose(self.arm.fk(self.q)),
            pose(self.arm.fk(self.desired)),
            supply_bar,
            *[0] * 7,
        )


def pose(X: np.ndarray) -> Pose:
    """A pose as it crosses the wire."""
    turned = Rotation.from_matrix(X[:3, :3]).as_quat(scalar_first=True)
    return Pose(tuple(X[:3, 3]), tuple(turned))


class Vision:
    """The other end, which drives this controller as it would drive any."""

    def __init__(self, peer: tuple[str, int]) -> None:
        self.socket, self.peer = udp(), peer
        self.link = ReferenceClient(nonce=1)
        self.link.connect(0)
        self.answers: list[Acknowledgement] = []
        self.state: State | None = None

    def cycle(self, now_ns: int, count: int) -> int:
        """Hear, and say what is due."""
        for data, _ in heard(self.socket, count):
            for event in self.link.receive(data, now_ns):
                if isinstance(event, AcknowledgementReceived):
                    self.answers.append(event.acknowledgement)
                elif isinstance(event, StateReceived):
                    self.state = event.state
        self.link.tick(now_ns)
        return sent(self.socket, [(data, self.peer) for data in self.link.outgoing(now_ns)])


controller = OwnController()
vision = Vision(controller.socket.getsockname())
now_ns, sent_data, way = 0, 0, []


def until(happened, limit_s: float) -> None:
    """Let both ends work until something has happened; time passes in steps of a cycle."""
    global now_ns, sent_data
    end_ns = now_ns + round(1e9 * limit_s)
    while not happened():
        if now_ns > end_ns:
            raise TimeoutError(f"not within {limit_s} s of the arm's time")
        now_ns += CYCLE_NS
        sent_data = vision.cycle(now_ns, controller.cycle(now_ns, sent_data))
        way.append((1e-9 * now_ns, *controller.plant.truth.X_BT[:3, 3]))


with controller.socket, vision.socket:
    until(lambda: vision.state is not None, 5.0)
    start = np.array(vision.state.X_BT.p_m)
    goal = vision.state.X_BT._replace(p_m=tuple(start + np.array([0.2, 0.3, -0.2])))
    vision.link.submit(ReferencePose(0, goal, 0.0), now_ns)
    until(lambda: len(vision.answers) == 1, 5.0)
    vision.link.submit(Command(0, CommandCode.ENABLE), now_ns)
    until(lambda: len(vision.answers) == 2, 5.0)
    moving = vision.link.submit(ReferencePose(0, goal, 0.0), now_ns)
    until(lambda: vision.state.motion_id == moving and vision.state.motion_done, 30.0)

for what, answer in zip(("pose", "enable", "pose"), vision.answers, strict=True):
    print(f"{what}: {answer.reason.name}")
times, *axes_m = np.array(way).T
seen_mm, true_mm = (
    1e3 * np.linalg.norm(np.subtract(place, goal.p_m)) for place in (vision.state.X_BT.p_m, way[-1][1:])
)
print(
    f"by its encoders {seen_mm:.1f} mm from the reference, in truth {true_mm:.1f} mm, after {times[-1]:.1f} s"
)

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, axis, wanted in zip("xyz", axes_m, goal.p_m, strict=True):
    (line,) = axes.plot(times, 1e3 * (axis - wanted), label=name)
axes.axhline(0.0, color="black", linestyle=":")
axes.set(xlabel="time, s", ylabel="true tool from the reference, mm", title="A controller of one's own")
axes.legend()
figure.savefig(picture, dpi=90)
