"""A kinematic arm and its eyes in simulated time, for tests without pixels: it bends, but has no oil.

The controller's model is rigid (nominal Denavit-Hartenberg at the encoders). The true arm: encoder offsets,
play in the slew, a hinge in each boom that gravity bends, a camera mount that nobody knows, and noise.
Every measurement follows from the true pose; nothing is canned.
"""

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed, RequestRefused
from protocol.faults import FaultCode, GroupState, Severity
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array, exp_so3, inverse, local, log_so3, retract, transform
from vision_pc.core.types import Look, WatchHealth, WatchSample

Q_START = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
_A2, _B2 = math.hypot(1.59687, 0.100002), math.atan2(0.100002, 1.59687)
# alpha, a, theta offset, d
_DH = (
    (math.pi / 2, -0.18926, 0.0, 0.85),
    (0.0, _A2, _B2, 0.0),
    (math.pi / 2, 0.15264, math.pi / 2 - _B2, 0.0),
    (math.pi / 2, 0.0, 0.0, 2.99949),
    (-math.pi / 2, 0.0, math.pi, 0.0),
    (math.pi / 2, 0.0, math.pi / 2, -0.35),
    (math.pi / 2, 0.0, 0.0, 0.0),
)


class Truth(NamedTuple):
    """What the arm and camera really are. Angles rad, lengths m; see ``draw``."""

    encoder_offset: Array  # (6,)
    compliance: Array  # (2,) rad per (kg m) of the load's moment about lift and tilt, vertical
    load_kg: float
    play: float  # half the slew's backlash
    X_TC: Array
    X_TM: Array
    X_BO: Array
    servo_std: float  # static joint error, redrawn at every standstill
    marker_std_m: float
    marker_std: float
    odometry_std_m: float
    odometry_std: float
    odometry_scale: float
    glitch_share: float
    missed_share: float


def draw(rng: np.random.Generator, **changes: object) -> Truth:
    """A random truth: mount to 10°, offsets to 5 mrad, object 0.3…0.9 m off; ``changes`` replace."""
    direction = rng.uniform(0.0, 2.0 * math.pi)
    across = rng.uniform(0.3, 0.9)
    X_BT0 = forward(Q_START)
    turn = exp_so3(rng.normal(0.0, math.radians(3.0), 3))
    offset = np.array([across * math.cos(direction), across * math.sin(direction), rng.uniform(0.3, 0.6)])
    X_TO = transform(np.diag([1.0, -1.0, -1.0]) @ turn, offset)
    axis = rng.normal(size=3)
    mount = exp_so3(axis / np.linalg.norm(axis) * rng.uniform(0.0, math.radians(10.0)))
    values: dict[str, object] = {
        "encoder_offset": rng.uniform(-0.005, 0.005, 6),
        "compliance": rng.uniform(0.5, 1.5, 2) * np.array([2.0e-5, 4.0e-5]),
        "load_kg": rng.uniform(60.0, 160.0),
        "play": 3.0e-4,
        "X_TC": transform(mount, np.array([-0.20, -0.05, -0.40]) + rng.normal(0.0, 0.02, 3)),
        "X_TM": transform(np.diag([1.0, -1.0, -1.0]) @ exp_so3(rng.normal(0.0, 0.01, 3)), np.zeros(3)),
        "X_BO": X_BT0 @ X_TO,
        "servo_std": 2.0e-4,
        "marker_std_m": 2.0e-4,
        "marker_std": math.radians(0.05),
        "odometry_std_m": 2.0e-4,
        "odometry_std": math.radians(0.02),
        "odometry_scale": 1.0 + rng.uniform(-1e-3, 1e-3),
        "glitch_share": 0.0,
        "missed_share": 0.0,
    }
    return Truth(**(values | changes))  # type: ignore[arg-type]


def chain(q: Array, bend: Array | None = None) -> list[Array]:
    """Poses of the base and of every link's end; ``bend`` (2,) turns each boom after its encoder."""
    X = np.eye(4)
    frames = [X]
    for i, (alpha, a, offset, d) in enumerate(_DH):
        theta = offset + (q[i] if i < 6 else 0.0)
        if bend is not None and i in (1, 2):
            theta += bend[i - 1]
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        link = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        X = X @ np.array(link)
        frames.append(X)
    return frames


def forward(q: Array, bend: Array | None = None) -> Array:
    """X_BT (4×4)."""
    return chain(q, bend)[-1]


def inverse_kinematics(X_BT: Array, q_near: Array) -> Array:
    """The joint angles near ``q_near`` whose nominal pose is ``X_BT``; RequestRefused when there are none."""
    q = q_near.copy()
    for _ in range(30):
        frames = chain(q)
        delta = local(frames[-1], X_BT)
        if np.linalg.norm(delta) < 1e-10:
            return q
        z = np.array([X[:3, 2] for X in frames[:6]])
        arms = frames[-1][:3, 3] - np.array([X[:3, 3] for X in frames[:6]])
        J = np.vstack([np.cross(z, arms).T, z.T])
        q = q + J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), delta)
        if np.max(np.abs(q - q_near)) > 1.5:
            break
    raise RequestRefused("refused.unreachable", "synthetic arm: no joint angles for this pose")


class SyntheticWatch:
    """Samples between entering and leaving."""

    def __init__(self, rig: "SyntheticRig", markers: bool, odometry: bool, X_BC0: Array) -> None:
        self.markers, self.odometry, self.X_BC0 = markers, odometry, X_BC0
        self.gathered: list[WatchSample] = []
        self.rig = rig
        self.waited_s = 0.0

    @property
    def samples(self) -> tuple[WatchSample, ...]:
        return tuple(self.gathered)

    @property
    def health(self) -> WatchHealth:
        lost = sum(s.X_C0C is None for s in self.gathered)
        return WatchHealth(len(self.gathered), lost, 0, 0, 200, None)

    async def after(self, count: int, timeout_s: float) -> WatchSample | None:
        """Lets time pass, in steps of a picture, as the port says."""
        self.waited_s += timeout_s
        if self.waited_s >= self.rig.period_s:
            self.waited_s -= self.rig.period_s
            if self.rig.stream is not None:
                self.rig.stream.follow(self.rig.period_s)
            else:
                self.rig.advance(self.rig.q)
        return self.gathered[-1] if len(self.gathered) > count else None


class SyntheticStream:
    """Implements the port's stream: the arm follows the newest reference with a lag and a bounded speed."""

    def __init__(self, rig: "SyntheticRig") -> None:
        self.rig = rig
        self.sent: list[Array] = []
        self.measured_ns: list[int | None] = []

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        self.sent.append(X_BT_ref)
        self.measured_ns.append(measured_ns)

    async def view(self) -> ArmView:
        return await self.rig.view()

    def follow(self, period_s: float) -> None:
        """One picture period later."""
        rig = self.rig
        X = forward(rig.q)
        way = np.zeros(6) if not self.sent else local(X, self.sent[-1])
        way[:3] += rig.hangs
        way *= min(1.0, period_s / 0.3, rig.speed * period_s / max(float(np.linalg.norm(way[:3])), 1e-12))
        rig.advance(inverse_kinematics(retract(X, way), rig.q))
        rig.q_cmd = rig.q


class SyntheticRig:
    """Arm and eyes in one: implements both ports. ``rate_hz`` pictures a second, ``speed`` in m/s."""

    def __init__(self, truth: Truth, seed: int, rate_hz: float = 10.0, speed: float = 0.15) -> None:
        self.truth, self.rng = truth, np.random.default_rng(seed)
        self.period_s, self.speed = 1.0 / rate_hz, speed
        self.q = Q_START.copy()
        self.slew_play = 0.0
        self.booms_play = np.zeros(2)
        self.time_ns = 0
        self.motions = 0
        self.watching: SyntheticWatch | None = None
        self.blind_object = False
        self.lose_odometry_after: int | None = None
        self.blind_after = self.freeze_after = self.silent_after = math.inf  # pictures of a watch
        self.stream: SyntheticStream | None = None
        self.hangs = np.zeros(3)  # how far beside a streamed reference the servo leaves the arm
        self.q_cmd = self.q
        self.slew_runs_on = 0.0  # rad: how much farther than told the slew turns at the end of every motion
        self.slew_swings = 0.0  # rad: how far a motion at full pace runs over its end, and comes back
        self.stopped = 0

    # what really is
    def X_BT_true(self) -> Array:
        q = self.q + self.truth.encoder_offset
        q[0] += self.slew_play
        q[1:3] += self.booms_play
        frames = chain(q)
        tip = frames[-1][:2, 3]
        reach = np.array([math.dist(tip, frames[i][:2, 3]) for i in (1, 2)])  # of the load from lift and tilt
        return forward(q, -self.truth.compliance * self.truth.load_kg * reach)

    def X_BC_true(self) -> Array:
        return self.X_BT_true() @ self.truth.X_TC

    def true_error(self, clearance_m: float) -> Array:
        """p_CO − p_CM − [0, 0, b] (3,) in the true camera's axes."""
        X_CB = inverse(self.X_BC_true())
        p_CO = (X_CB @ self.truth.X_BO)[:3, 3]
        p_CM = (inverse(self.truth.X_TC) @ self.truth.X_TM)[:3, 3]
        return p_CO - p_CM - np.array([0.0, 0.0, clearance_m])

    def true_orientation_error(self) -> float:
        """Angle (rad) between tool marker and object."""
        R_BM = (self.X_BT_true() @ self.truth.X_TM)[:3, :3]
        return float(np.linalg.norm(log_so3(R_BM.T @ self.truth.X_BO[:3, :3])))

    # the arm
    async def view(self) -> ArmView:
        X, X_cmd = forward(self.q), forward(self.q_cmd)
        return ArmView(
            self.time_ns, GroupState.STANDBY, FaultCode.NONE, Severity.NONE, self.motions, True, True,
            self.q.copy(), self.q_cmd.copy(), X, X_cmd,
        )  # fmt: skip

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        return await self.follow([X_BT_ref], duration_s)

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        starts = self.q
        planned = []
        for X in waypoints:
            starts = inverse_kinematics(X, starts)
            planned.append(starts)
        self.motions += 1
        for q_goal in planned:
            q_from, X_from, X_goal = self.q.copy(), forward(self.q), forward(q_goal)
            steps = max(int(np.linalg.norm(local(X_from, X_goal)) / self.speed / self.period_s), 3)
            for k in range(1, steps + 1):
                u = k / steps
                u = u * u * u * (10.0 + u * (6.0 * u - 15.0))
                self.advance(inverse_kinematics(retract(X_from, u * local(X_from, X_goal)), q_from))
            for _ in range(int(dwell_s / self.period_s)):
                self.advance(self.q)
        turned = np.eye(6)[0] * np.sign(planned[-1][0] - q_from[0])
        if self.slew_swings and not segment_s:
            self.advance(planned[-1] + turned * self.slew_swings)
        self.q_cmd = planned[-1]
        self.advance(planned[-1] + turned * self.slew_runs_on + self.rng.normal(0.0, self.truth.servo_std, 6))
        for _ in range(5):
            self.advance(self.q)
        return await self.view()

    @asynccontextmanager
    async def streaming(self) -> AsyncIterator[SyntheticStream]:
        self.stream = stream = SyntheticStream(self)
        self.motions += 1
        try:
            yield stream
        except BaseException:
            self.stopped += 1
            raise
        finally:
            self.stream = None

    async def stop(self) -> None:
        self.stopped += 1

    def advance(self, q: Array) -> None:
        """The encoders read ``q`` one picture period later; a watch takes its sample."""
        dq = q[0] - self.q[0]
        self.slew_play = float(np.clip(self.slew_play - dq, -self.truth.play, self.truth.play))
        self.q = q.copy()
        self.time_ns += int(self.period_s * 1e9)
        if self.watching is not None and len(self.watching.gathered) < self.silent_after:
            self.watching.gathered.append(self._sample(self.watching))

    # the eyes
    def _noisy(self, X: Array, std_m: float, std: float) -> Array:
        return retract(X, np.concatenate([self.rng.normal(0, std_m, 3), self.rng.normal(0, std, 3)]))

    def _sample(self, watch: SyntheticWatch) -> WatchSample:
        t = self.truth
        X_BC = self.X_BC_true()
        X_C0C = None
        lost = self.lose_odometry_after is not None and len(watch.gathered) >= self.lose_odometry_after
        if watch.odometry and not lost:
            X = inverse(watch.X_BC0) @ X_BC
            X[:3, 3] *= t.odometry_scale
            X_C0C = self._noisy(X, t.odometry_std_m, t.odometry_std)
            if self.rng.random() < t.glitch_share:
                X_C0C = self._noisy(X_C0C, 0.3, 0.3)
        count = len(watch.gathered)
        if count >= self.freeze_after:
            last = watch.gathered[-1]
            return last._replace(time_ns=self.time_ns, X_BT=forward(self.q))
        seen = watch.markers and self.rng.random() >= t.missed_share and count < self.blind_after
        X_CM = self._noisy(inverse(t.X_TC) @ t.X_TM, t.marker_std_m, t.marker_std) if seen else None
        X_CO = None
        if seen and not self.blind_object:
            X_CO = self._noisy(inverse(X_BC) @ t.X_BO, t.marker_std_m, t.marker_std)
        return WatchSample(self.time_ns, forward(self.q), X_C0C, X_CM, X_CO)

    async def look(self, frames: int | None = None) -> Look:
        if self.blind_object:
            raise MeasurementFailed(
                "measurement.object_not_seen", "object seen in 0 of 10 pictures, 5 are wanted"
            )
        t, n = self.truth, frames or 10
        X_CM = self._noisy(inverse(t.X_TC) @ t.X_TM, t.marker_std_m / n**0.5, t.marker_std / n**0.5)
        X_CO = self._noisy(inverse(self.X_BC_true()) @ t.X_BO, t.marker_std_m / n**0.5, t.marker_std / n**0.5)
        self.time_ns += int(n * self.period_s * 1e9)
        cov = np.diag([t.marker_std_m**2] * 3 + [t.marker_std**2] * 3) / n
        fields = {
            "time_ns": self.time_ns, "X_CM": X_CM, "X_CO": X_CO, "X_BT": forward(self.q), "frames": n,
            "failed_tool": 0, "failed_object": 0, "cov_CM": cov, "cov_CO": cov,
            "frame_cov_CM": cov * n, "frame_cov_CO": cov * n, "offset": None,
        }  # fmt: skip
        return Look(**fields)  # type: ignore[arg-type]

    @asynccontextmanager
    async def watch(self, *, markers: bool, odometry: bool) -> AsyncIterator[SyntheticWatch]:
        self.watching = SyntheticWatch(self, markers, odometry, self.X_BC_true())
        self.watching.gathered.append(self._sample(self.watching))
        try:
            yield self.watching
        finally:
            self.watching = None


def silent(progress: float, note: str) -> None:
    """A report that nobody reads; progress must stay in 0…1."""
    assert 0.0 <= progress <= 1.0, (progress, note)
