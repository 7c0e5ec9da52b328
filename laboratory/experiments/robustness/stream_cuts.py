"""Many cuts of the reference stream at random moments of streamed motions, in lockstep, without pictures."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.campaigns.options import Assignments, Scenario
from plant_emulator.config.valves import JOINT_NAMES
from protocol.datagram_layout import Kind
from protocol.errors import LinkLost
from protocol.faults import CommandCode, FaultCode, GroupState
from protocol.process_image import STATUS_VALVES_ENABLED
from protocol.reference_messages import StreamedPose
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.reporting.console import table
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from vision_pc.core.se3 import Array, exp_so3, from_pose, to_pose


class CutSettings(NamedTuple):
    """The world that the streams are cut in."""

    scenario: Scenario = "standard"
    assignments: Assignments = None


class CutRow(NamedTuple):
    """One cut: what was drawn, and ms from the last fresh reference to the last command and to zero flow."""

    rate_hz: float
    cut: str
    speed_m_s: float
    command_ms: float
    flow_ms: float
    resumed: bool
    fault: str
    failure: str
    cpu_s: float

    @property
    def passed(self) -> bool:
        """Whether valves and oil stopped in time and for good, for the right cause; a failed run did not."""
        in_time = self.command_ms <= COMMAND_MS and self.flow_ms <= FLOW_MS
        sound = not self.resumed and self.fault == FaultCode.REFERENCE_STALE.name
        return in_time and sound and not self.failure


def cut_tasks(request: CampaignRequest, settings: CutSettings) -> list[Task]:
    """One task a seed."""
    asked = {"scenario": settings.scenario, "assignments": settings.assignments or []}
    return [{"key": f"{seed}", "seed": seed} | asked for seed in seeds(request)]


def one_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of one seeded cut, in the world of its scenario and seed."""
    overrides = chosen_overrides(config_dir, task["scenario"], task["seed"], task["assignments"])
    return one_cut(load_settings(config_dir, overrides), task["seed"])


Cuts = Finished[CutSettings, CutRow]


def cut_table(done: Cuts) -> list[Table]:
    """The distribution of both times, by rate, by kind of cut, and of all."""
    groups: list[tuple[str, list[CutRow]]] = [
        *((f"{rate:g} Hz", [row for row in done.rows if row.rate_hz == rate]) for rate in RATES_HZ),
        *((f"{cut} cut", [row for row in done.rows if row.cut == cut]) for cut in CUTS),
        ("all", list(done.rows)),
    ]
    columns = (
        "", "runs", "speed, m/s",
        "command: p50", "p95", "max",
        "flow: p50", "p95", "max",
        "resumed", "failed", "verdict",
    )  # fmt: skip
    title = "last fresh reference → last valve command that is not neutral, and → zero flow, ms"
    limits = ("limit", "", "", "", "", COMMAND_MS, "", "", FLOW_MS, 0, 0, "")
    return [table(title, columns, [limits, *(_line(name, group) for name, group in groups if group)])]


def _line(name: str, rows: Sequence[CutRow]) -> tuple[object, ...]:
    done = [row for row in rows if not row.failure]
    cells: list[str] = []
    for values in ([row.command_ms for row in done], [row.flow_ms for row in done]):
        cells += [f"{value:.1f}" for value in np.percentile(values or [np.nan], [50, 95, 100])]
    speeds = [row.speed_m_s for row in done] or [np.nan]
    failed = sum(not row.passed for row in rows)
    span = f"{min(speeds):.2f}…{max(speeds):.2f}"
    resumed = sum(row.resumed for row in done)
    return name, len(rows), span, *cells, resumed, failed, "FAIL" if failed else "pass"


def cut_verdict(done: Cuts) -> list[Check]:
    """No valve command and no oil for too long, nothing resumed, the fault named, in every run."""
    ended = [row for row in done.rows if not row.failure]
    command, flow = (
        max([getattr(row, name) for row in ended], default=np.nan) for name in ("command_ms", "flow_ms")
    )
    good = sum(row.passed for row in done.rows)
    return [
        Check(
            "last valve command, worst", f"{command:.1f} ms", f"≤ {COMMAND_MS:g} ms", command <= COMMAND_MS
        ),
        Check("zero flow, worst", f"{flow:.1f} ms", f"≤ {FLOW_MS:g} ms", flow <= FLOW_MS),
        Check(
            "cuts that stopped in time and for good, with the fault REFERENCE_STALE",
            f"{good} of {len(done.rows)}",
            "all",
            good == len(done.rows),
        ),
    ]


STREAM_CUTS = Experiment(
    name="stream-cuts",
    title="Cut the reference stream at random moments.",
    settings=CutSettings,
    row=CutRow,
    tasks=cut_tasks,
    run=one_run,
    table=cut_table,
    verdict=cut_verdict,
    runs=459,
    eyes="none",
)


RATES_HZ = (15.0, 20.0, 30.0, 60.0)
KINDS = ("point", "jitter", "sway", "circle")
CUTS = ("stream", "link", "bye")
COMMAND_MS, FLOW_MS = 100.0, 130.0  # no valve command, no oil later than this after the last fresh reference
_KIND_AT = 6  # of a datagram
_MIN_SPEED_M_S = 0.02  # of the commanded tool at the cut: a cut at rest would show nothing
_LONGEST_S = 8.0
_WATCHED_S = 1.0
_RETURNS_S = 0.3  # after the cut the references come again: nothing may follow them


class Motion(NamedTuple):
    """How the reference moves from the start: by ``reach`` (m) along ``u`` and ``v``, with ``omega`` (rad/s).

    A point, and one that measurement noise moves, lie 2 ``reach`` away; ``turn`` is a rotation vector.
    """

    kind: str
    reach: float
    omega: float
    u: Array
    v: Array
    turn: Array

    def at(self, X_BT: Array, t: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """The reference (4, 4) and its twist (6,) at ``t`` s after the start at ``X_BT``."""
        X, twist = X_BT.copy(), np.zeros(6)
        c, s = math.cos(self.omega * t), math.sin(self.omega * t)
        if self.kind == "sway":
            X[:3, 3] += self.reach * s * self.u
            twist[:3] = self.reach * self.omega * c * self.u
        elif self.kind == "circle":
            X[:3, 3] += self.reach * (s * self.u + (1.0 - c) * self.v)
            X[:3, :3] = exp_so3(self.turn * s) @ X[:3, :3]
            twist[:3] = self.reach * self.omega * (c * self.u + s * self.v)
        else:
            X[:3, 3] += 2.0 * self.reach * self.u
            X[:3, :3] = exp_so3(self.turn) @ X[:3, :3]
            if self.kind == "jitter":
                X[:3, 3] += rng.normal(scale=1e-3, size=3)
        return X, twist


class CutStream:
    """The world of one run, with the stream's clock: references at ``rate_hz`` until they are cut."""

    def __init__(self, settings: Settings, seed: int, rate_hz: float, motion: Motion) -> None:
        self.rng = np.random.default_rng([seed, 2])
        self.world = World(settings, seed, RunLog())
        self.world.lead_ns = int(self.rng.integers(0, round(1e6 * settings.controller.cycle_ms)))
        self.reached_ns = 0
        self.begun_ns = 0
        self._rate_hz = rate_hz
        self._motion = motion
        self._sent = 0
        self.world.connect()
        run(self.world.link.command(CommandCode.ENABLE))
        run(self.world.link.next_state())
        self._start = from_pose(self.world.states[-1].X_BT)
        self.stream_id = run(self.world.link.command(CommandCode.START_STREAM)).command_id
        self.begun_ns = self.world.time_ns
        self.world.to_controller = self._noting

    @property
    def running_s(self) -> float:
        """Since the stream began."""
        return 1e-9 * (self.world.time_ns - self.begun_ns)

    def send_due(self) -> None:
        """Sends the next reference when its time has come."""
        if self.running_s * self._rate_hz < self._sent:
            return
        self._sent += 1
        X, twist = self._motion.at(self._start, self.running_s, self.rng)
        a, b, c, d, e, f = twist.tolist()
        reference = StreamedPose(
            self.stream_id, self._sent, self.world.vision_ns, to_pose(X), (a, b, c, d, e, f)
        )
        self.world.link.stream(reference)

    def _noting(self, datagrams: list[bytes]) -> list[bytes]:
        """All that was sent arrives; when a reference does is noted."""
        if any(data[_KIND_AT] == Kind.STREAMED_POSE for data in datagrams):
            self.reached_ns = self.world.time_ns - self.world.lead_ns
        return datagrams


def one_cut(settings: Settings, seed: int) -> dict[str, Any]:
    """The figures of the cut of ``seed``: ms since the last fresh reference had reached the controller.

    ``command_ms``: until the last valve command that was not neutral had been replaced in the coupler.
    ``flow_ms``: until the last spool was inside its overlap for good, by the plant's truth.
    """
    rng = np.random.default_rng([seed, 1])
    rate_hz, kind, cut = float(rng.choice(RATES_HZ)), str(rng.choice(KINDS)), str(rng.choice(CUTS))
    stream = CutStream(settings, seed, rate_hz, _draw_motion(rng, kind))
    world = stream.world
    cut_s = float(rng.uniform(0.3, 1.6 if kind in ("point", "jitter") else 5.0))  # before a point is reached
    while stream.running_s < cut_s or _speed(world) < _MIN_SPEED_M_S:
        if stream.running_s > _LONGEST_S:
            raise LinkLost("link.no_motion", f"seed {seed}: the {kind} came to rest before its cut")
        stream.send_due()
        world.clock.advance()
    speed = _speed(world)
    drawn = {"rate_hz": rate_hz, "motion": kind, "cut": cut, "speed_m_s": speed}
    seen = _watch_plant(stream, cut)
    in_time = seen["command_ms"] <= COMMAND_MS and seen["flow_ms"] <= FLOW_MS
    sound = in_time and not seen["resumed"] and seen["fault"] == FaultCode.REFERENCE_STALE.name
    return drawn | seen | {"pass": sound}


def _watch_plant(stream: CutStream, cut: str) -> dict[str, Any]:
    """What the plant does once the references have ceased, and whether it takes notice of later ones."""
    world, reached_ns = stream.world, stream.reached_ns
    if cut == "link":
        world.to_controller = lambda datagrams: []
    elif cut == "bye":
        world.link.disconnect()
    valves = world.settings.plant.valves
    shut = min(min(valves.of(name, 1.0).deadband) for name in JOINT_NAMES)
    command_ms = flow_ms = 0.0
    resumed = False
    while world.time_ns - reached_ns < _WATCHED_S * 1e9:
        before_ms = 1e-6 * (world.time_ns - reached_ns)
        opening = float(np.abs(world.plant.truth().spools).max())
        if cut == "stream" and world.time_ns - reached_ns > _RETURNS_S * 1e9:
            stream.send_due()
        world.clock.advance()
        until_ms = 1e-6 * (world.time_ns - reached_ns)
        truth = world.plant.truth()
        if np.any(truth.valves):
            command_ms = until_ms
            resumed |= before_ms > COMMAND_MS
        if max(opening, float(np.abs(truth.spools).max())) > shut:
            flow_ms = until_ms
    state = world.states[-1]
    said = [event["what"] for event in world.log.events if event["event"] == "controller"]
    faults = [what["cause"] for what in said if what["name"] == "fault"]
    return {
        "command_ms": command_ms,
        "flow_ms": flow_ms,
        "resumed": resumed or bool(world.plant.read().status & STATUS_VALVES_ENABLED),
        "fault": faults[0] if faults else state.fault.name,
        "group": GroupState(state.group_state).name,
    }


def _speed(world: World) -> float:
    """Of the tool, as the last two states show it (m/s)."""
    older, newer = world.states[-2], world.states[-1]
    way = np.subtract(newer.X_BT_cmd.p_m, older.X_BT_cmd.p_m)
    return float(np.linalg.norm(way)) / (1e-9 * (newer.time_ns - older.time_ns))


def _draw_motion(rng: np.random.Generator, kind: str) -> Motion:
    u = rng.normal(size=3)
    u /= np.linalg.norm(u)
    v = np.cross(u, rng.normal(size=3))
    v /= np.linalg.norm(v)
    omega = float(rng.uniform(0.4, 0.9))
    reach = float(rng.uniform(0.06, 0.1)) if kind in ("sway", "circle") else float(rng.uniform(0.1, 0.2))
    turn = rng.normal(size=3)
    return Motion(kind, reach, omega, u, v, turn * (0.15 / np.linalg.norm(turn)))
