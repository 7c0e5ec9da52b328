"""Commands and references through the scan: answers, guards, what reaches the valves."""

import itertools

import pytest

from controller.core.settings import ScanSettings
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.process_image import (
    CONTROL_ENABLE,
    CONTROL_RESET_WATCHDOG,
    STATUS_SUPPLY_ON,
    STATUS_WATCHDOG_TRIPPED,
)
from protocol.reference_messages import (
    FLAG_SETTLED,
    Command,
)
from tests.controller.obedient_plant import Bench

ZERO = (0.0,) * 6


def test_enabling_moves_nothing(settings: ScanSettings) -> None:
    bench = Bench(settings).enabled()
    bench.run(2.0)
    assert all(output.valves.valves == pytest.approx(ZERO, abs=1e-6) for output in bench.outputs)
    assert bench.last.view.q_cmd == pytest.approx(bench.last.view.q_meas, abs=1e-6)
    assert bench.last.view.flags & FLAG_SETTLED


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda b: setattr(b, "link_alive", False), Reason.REFERENCE_LINK_DOWN),
        (lambda b: setattr(b, "supply_bar", 20.0), Reason.PLANT_NOT_READY),
        (lambda b: setattr(b, "status", 0), Reason.PLANT_NOT_READY),
    ],
)
def test_enable_is_guarded(settings: ScanSettings, spoil: object, reason: Reason) -> None:
    bench = Bench(settings)
    spoil(bench)  # type: ignore[operator]
    bench.step()
    assert bench.command(CommandCode.ENABLE) is reason
    assert bench.state.mode is Mode.DISABLED


def test_enable_without_a_plant_is_refused(settings: ScanSettings) -> None:
    bench = Bench(settings, silent=True)
    bench.step()
    assert bench.command(CommandCode.ENABLE) is Reason.PLANT_LINK_DOWN


@pytest.mark.parametrize(
    ("gone", "reason"),
    [(("silent", True), Reason.PLANT_LINK_DOWN), (("link_alive", False), Reason.REFERENCE_LINK_DOWN)],
)
def test_reset_is_guarded(settings: ScanSettings, gone: tuple[str, bool], reason: Reason) -> None:
    bench = Bench(settings).moving()
    bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
    bench.step()
    bench.status = STATUS_SUPPLY_ON
    bench.step()
    setattr(bench, *gone)
    bench.run(0.1)
    assert bench.command(CommandCode.RESET) is reason


def test_a_tripped_plant_watchdog_is_rearmed_while_disabled(settings: ScanSettings) -> None:
    bench = Bench(settings, status=STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED)
    bench.step()
    assert bench.last.valves.control & CONTROL_RESET_WATCHDOG, "the first edge is not waited for"
    bench.run(0.01)
    assert not bench.last.valves.control & CONTROL_RESET_WATCHDOG
    assert bench.command(CommandCode.ENABLE) is Reason.ACCEPTED


@pytest.mark.parametrize("scans", range(1, 20))
def test_enable_may_follow_reset_at_once(settings: ScanSettings, scans: int) -> None:
    """Whenever the two come after the watchdog's fault: RESET, and ENABLE in the same scan."""
    bench = Bench(settings).moving()
    bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
    for _ in range(scans + 1):
        bench.step()
    assert bench.state.mode is Mode.ERROR_HELD, "re-arming clears no fault"
    answers = bench.step(Command(900, CommandCode.RESET), Command(901, CommandCode.ENABLE)).acknowledgements
    assert [answer.reason for answer in answers] == [Reason.ACCEPTED, Reason.ACCEPTED]


def test_enable_may_follow_release_and_reset_at_once(settings: ScanSettings) -> None:
    bench = Bench(settings).moving()
    bench.command(CommandCode.EMERGENCY_STOP)
    bench.status = STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED
    bench.run(0.02)
    codes = CommandCode.EMERGENCY_RELEASE, CommandCode.RESET, CommandCode.ENABLE
    answers = bench.step(*(Command(900 + code, code) for code in codes)).acknowledgements
    assert [answer.reason for answer in answers] == [Reason.ACCEPTED] * 3


def test_a_plant_that_hears_no_edge_gets_another_one(settings: ScanSettings) -> None:
    bench = Bench(settings, status=STATUS_SUPPLY_ON | STATUS_WATCHDOG_TRIPPED, hears_reset=False)
    bench.run(0.24)
    high = [bool(output.valves.control & CONTROL_RESET_WATCHDOG) for output in bench.outputs]
    edges = [k for k, (before, now) in enumerate(itertools.pairwise([False, *high])) if now and not before]
    assert edges == [0, 16, 32]
    assert not any(output.valves.control & CONTROL_ENABLE for output in bench.outputs)
