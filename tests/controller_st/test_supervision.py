"""The same misbehaving plant before both controllers: the same fault, severity and mode in the same scan."""

from collections.abc import Callable
from typing import Any

import pytest

from controller.core.settings import settings_from
from controller_st.program import TextController
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, Reason
from protocol.pose import Pose
from protocol.process_image import (
    STATUS_SENSOR_FAULT,
    STATUS_SUPPLY_ON,
    STATUS_WATCHDOG_TRIPPED,
    SensorImage,
    encode_sensors,
)
from protocol.reference_messages import Command, ReferencePose, Request
from testbed.scenarios.scenario import load_settings
from tests.controller.obedient_plant import Bench
from tests.support.paths import CONFIGS

POSE_KIND, COMMAND_KIND = 5, 7


class BothBenches(Bench):
    """A bench whose images the text gets too. Requests are put where its session would have them wait."""

    image: SensorImage | None = None

    def pair(self, text: TextController) -> "BothBenches":
        """This bench, with ``text`` beside it."""
        self.text = text
        self.link = self.text.memory.PRG_LR_Controller.stLink
        self.seen: list[tuple[Any, ...]] = []
        return self

    def _exchange(self) -> SensorImage:
        self.image = super()._exchange()
        return self.image

    def both(self, *requests: Request) -> None:
        """One scan of each; modes, faults and severities are the same."""
        self.image = None
        late_s = self.late_s
        output = self.step(*requests)
        self.link.stOpen.nNumber = 1 if self.link_alive else 0
        self.link.stOpen.nHeard_ns = self.now_ns
        for request in requests:
            self._wait(request)
        words = None if self.image is None else encode_sensors(self.image)
        assert self.text.step(self.now_ns, self.now_ns, self.settings.cycle_s + late_s, words) is None
        view, arm = output.view, self.text.arm
        python = self.state.mode, view.fault, view.severity, view.flags & 3, output.valves.control
        text = Mode(arm.eMode), arm.eFault, arm.eSeverity, self._flags(), self.text.valve_words[1]
        assert text == python, f"scan {len(self.outputs)}"
        if view.fault:
            assert arm.fFaultValue == pytest.approx(self.state.fault.value, rel=1e-6, nan_ok=True)
            assert arm.fFaultLimit == pytest.approx(self.state.fault.limit, rel=1e-9)
        self.seen.append(python)

    def _flags(self) -> int:
        return int(self.text.memory.PRG_LR_Controller.stState.flags) & 3

    def _wait(self, request: Request) -> None:
        asked = self.link.aQueue[self.link.nQueued]
        asked.nId, asked.nCount, asked.nKind = 5, 1, COMMAND_KIND
        if isinstance(request, Command):
            asked.nCode = request.code
        elif isinstance(request, ReferencePose):
            asked.nKind, asked.fSeconds, asked.xTimesFinite = POSE_KIND, request.duration_s, True
            pose = asked.aPoses[0]
            pose.x, pose.y, pose.z = request.X_BT_ref.p_m
            pose.qw, pose.qx, pose.qy, pose.qz = request.X_BT_ref.q_wxyz
            asked.aFinite[0] = True
        self.link.nQueued = self.link.nQueued + 1

    def in_motion(self, goal_z: float = 0.3) -> "BothBenches":
        """Both enabled, in the middle of a motion where ``goal_z`` is not 0."""
        self.both()
        self.both(Command(1, CommandCode.ENABLE))
        self.both()
        if goal_z:
            here = self.last.view.X_BT
            raised = Pose((here.p_m[0], here.p_m[1], here.p_m[2] + goal_z), here.q_wxyz)
            self.both(ReferencePose(2, raised, 0.0))
            for _ in range(150):
                self.both()
        return self


def _set(**values: Any) -> Callable[[Bench], None]:
    """What gives a bench these fields."""

    def breaks(bench: Bench) -> None:
        for name, value in values.items():
            setattr(bench, name, value)

    return breaks


BREAKS = {
    "silent": (_set(silent=True), FaultCode.PLANT_LINK_LOST),
    "frozen": (_set(frozen=True), FaultCode.PLANT_CYCLE_FROZEN),
    "deaf": (_set(deaf=True), FaultCode.PLANT_LINK_LOST),
    "tripped": (_set(status=STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED), FaultCode.PLANT_WATCHDOG),
    "sensor": (_set(status=STATUS_SUPPLY_ON | STATUS_SENSOR_FAULT), FaultCode.PLANT_STATUS),
    "no pump": (_set(status=0), FaultCode.SUPPLY_PRESSURE_LOST),
    "low supply": (_set(supply_bar=60.0), FaultCode.SUPPLY_PRESSURE_LOST),
    "not enabled": (_set(enables=False), FaultCode.PLANT_STATUS),
    "jump": (_set(offset=(0.0, 0.03, 0.0, 0.0, 0.0, 0.0)), FaultCode.ENCODER_JUMP),
    "late": (_set(late_s=2.5), FaultCode.OVERRUN),
    "stuck": (_set(stuck=True), FaultCode.ENCODER_STUCK),
    "alone": (_set(link_alive=False), FaultCode.REFERENCE_LINK_LOST),
}


@pytest.fixture
def pair() -> BothBenches:
    shipped = load_settings(CONFIGS, {})
    text = TextController(shipped.arm, shipped.controller, 1, lambda: 1)
    return BothBenches(settings_from(shipped.arm, shipped.controller)).pair(text)


@pytest.mark.slow("the program is compiled")
@pytest.mark.parametrize("name", BREAKS)
def test_both_find_the_same_fault_in_the_same_scan(pair: BothBenches, name: str) -> None:
    breaks, fault = BREAKS[name]
    bench = pair.in_motion()
    breaks(bench)
    for _ in range(200):
        bench.both()
    assert bench.seen[-1][1] is fault
    assert bench.seen[-1][0] is Mode.ERROR_HELD
    assert bench.seen[-1][4] & 1 == 0
    bench.silent = bench.frozen = bench.deaf = bench.stuck = False
    bench.status, bench.supply_bar, bench.enables, bench.link_alive = STATUS_SUPPLY_ON, 190.0, True, True
    for code in (CommandCode.RESET, CommandCode.ENABLE):
        for _ in range(20):
            bench.both()
        bench.both(Command(3, code))
    assert bench.seen[-1][0] is Mode.STANDBY


@pytest.mark.parametrize(("heard_ns", "lives"), [(40_000, True), (-500_000_000, True), (-501_000_000, False)])
def test_a_datagram_read_after_the_scan_took_its_time_ends_no_session(
    pair: BothBenches, heard_ns: int, lives: bool
) -> None:
    """A shell takes the time, then reads what has come: heard is later than now, by microseconds."""
    bench, now_ns = pair.in_motion(0.0), 10**10
    bench.link.stOpen.nNumber, bench.link.stOpen.nHeard_ns = 1, now_ns + heard_ns
    bench.text.step(now_ns, now_ns, bench.settings.cycle_s, None)
    assert (bench.text.session == 1) is lives
    assert lives or bench.text.ended_by == Reason.LINK_TIMEOUT


def test_at_rest_a_silent_link_disables_both_without_a_fault(pair: BothBenches) -> None:
    bench = pair.in_motion(0.0)
    bench.link_alive = False
    bench.both()
    assert bench.seen[-1][:2] == (Mode.DISABLED, FaultCode.NONE)
