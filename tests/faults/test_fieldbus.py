"""Faults 20 to 27 of the fieldbus: real sockets and a proxy, judged at the coupler's registers."""

import asyncio
import struct
from itertools import pairwise

import pytest

from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.process_image import CONTROL_ENABLE, OUTPUT_ADDRESS, ValveImage, encode_valves
from tests.faults.fieldbus import fieldbus
from tests.faults.registers import assert_shut
from tests.faults.rig import CLOSING_NS
from tests.support.fault_proxy import MS, Delivery

pytestmark = pytest.mark.realtime

WATCHDOG_S = 0.1


def passed(data: bytes) -> list[Delivery]:
    return [Delivery(0, data)]


async def test_case_20_a_lost_answer_is_not_answered_by_a_second_write() -> None:
    async with fieldbus() as rig:
        await rig.moving()
        written = len(rig.registers.written)
        rig.answers.begin(lambda data, number: [] if number in (3, 9) else passed(data))
        await rig.run(0.3)
        assert rig.link.failures["timeout"] == 2
        assert rig.answers.packets >= 9
        assert len(rig.registers.written) > written + 9
        rig.assert_written_once()
        await rig.assert_completes()


async def test_case_21_a_late_answer_is_not_taken_for_the_next_one() -> None:
    async with fieldbus(timeout_ms=120.0) as rig:
        await rig.moving()
        rig.answers.begin(lambda data, number: [Delivery(180 * MS if number == 3 else 0, data)])
        for _ in range(60):
            await rig.step()
            await asyncio.sleep(0.004)  # long enough for the late one to come in between
            sensors = rig.state.watch.sensors
            assert sensors is not None
            if rig.state.watch.missed == 0:
                assert sensors.echo_cycle == rig.outputs[-2].valves.controller_cycle
        assert rig.link.connections == 2
        rig.assert_written_once()
        await rig.assert_completes()


def refusal(data: bytes, code: int) -> list[Delivery]:
    """The exception in place of the answer."""
    return passed(data[:4] + struct.pack(">HBBB", 3, data[6], data[7] | 0x80, code))


async def test_case_22_busy_is_asked_again_a_bounded_number_of_times() -> None:
    async with fieldbus() as rig:
        await rig.moving()
        rig.answers.begin(lambda data, number: refusal(data, 6) if number <= 8 else passed(data))
        await rig.assert_completes()
        rig.assert_written_once()
    async with fieldbus() as rig:
        await rig.moving()
        began_ns = rig.now_ns
        rig.answers.begin(lambda data, _: refusal(data, 6))
        await rig.run(0.5)
        rig.assert_safe(FaultCode.PLANT_LINK_LOST, began_ns, 0.07)


@pytest.mark.parametrize("code", [0, 1, 2, 3, 4, 5, 10, 255])
async def test_case_22_any_other_exception_stops_the_arm_at_once(code: int) -> None:
    async with fieldbus() as rig:
        await rig.moving()
        began_ns = rig.now_ns
        rig.answers.begin(lambda data, number: refusal(data, code) if number == 1 else passed(data))
        await rig.run(0.5)
        rig.assert_safe(FaultCode.PLANT_LINK_LOST, began_ns, 0.011)


async def test_case_23_a_reset_connection_is_made_anew_and_nothing_is_written_twice() -> None:
    async with fieldbus() as rig:
        await rig.moving()
        for _ in range(2):
            rig.proxy.reset()
            await rig.run(0.1)
        assert rig.link.connections == 3
        rig.assert_written_once()
        if rig.view.view.fault is FaultCode.NONE:  # back within the tolerated misses
            await rig.assert_completes()
        else:
            assert rig.view.view.fault is FaultCode.PLANT_LINK_LOST
            assert_shut(rig.registers, rig.now_ns - 1)


async def test_case_24_a_half_open_connection_is_found_within_250_ms() -> None:
    async with fieldbus(timeout_ms=60.0) as rig:
        await rig.moving()
        began_ns = rig.now_ns
        rig.requests.begin(lambda _, __: [])
        rig.answers.begin(lambda _, __: [])
        found_s = await rig.until(lambda: rig.view.view.group_state is GroupState.ERROR_STOP)
        assert found_s < 0.25
        await rig.run(0.4)
        assert_shut(rig.registers, began_ns + round(WATCHDOG_S * 1e9) + CLOSING_NS)
        rig.requests.begin(None)
        rig.answers.begin(None)
        await rig.run(0.5)
        rig.assert_safe(FaultCode.PLANT_LINK_LOST, began_ns, WATCHDOG_S)
        assert await rig.command(CommandCode.ENABLE) is Reason.ERROR_LATCHED


async def test_case_25_frames_in_pieces_are_put_together_both_ways() -> None:
    async with fieldbus(timeout_ms=1000.0) as rig:
        await rig.moving()
        failures = rig.link.failures.total()

        def pieces(data: bytes, _: int) -> list[Delivery]:
            cuts = [0, 1, 5, 7, 8, 20, len(data) - 1, len(data)]
            return [Delivery(k * MS // 4, data[a:b]) for k, (a, b) in enumerate(pairwise(cuts))]

        rig.requests.begin(pieces)
        rig.answers.begin(pieces)
        await rig.run(0.25)
        rig.requests.begin(None)
        rig.answers.begin(None)
        assert rig.link.failures.total() == failures
        rig.assert_written_once()
        await rig.assert_completes()


def write_all(image: ValveImage) -> bytes:
    """FC 16 with a whole image."""
    return struct.pack(">BHHB12H", 16, OUTPUT_ADDRESS, 12, 24, *encode_valves(image))


async def test_case_26_a_second_writer_is_refused_and_does_not_reach_the_registers() -> None:
    alien = ValveImage(40_000, CONTROL_ENABLE, (1.0,) * 6)
    async with fieldbus() as rig:
        await rig.moving()
        for _ in range(40):
            await rig.step()
            assert rig.registers.coupler.answer("second", 1, write_all(alien)) == b"\x90\x06"
        assert not [row for row in rig.registers.written if row.image.controller_cycle == 40_000]
        await rig.assert_completes()


@pytest.mark.parametrize(("exchanges", "stops"), [(5, False), (1000, True)])
async def test_case_27_a_torn_image_is_not_believed(exchanges: int, stops: bool) -> None:
    async with fieldbus() as rig:
        await rig.moving()
        whole, left = rig.registers._words, [exchanges]

        def torn() -> list[int]:
            words = whole()
            if left[0] > 0:
                left[0] -= 1
                words[4:16] = [0] * 12  # the encoders of another instant
                words[-1] ^= 1
            return words

        began_ns = rig.now_ns
        rig.registers.coupler._image._sensor_words = torn
        await rig.run(0.6)
        if stops:
            assert rig.torn > 50
            rig.assert_safe(FaultCode.PLANT_LINK_LOST, began_ns, 0.07)
        else:
            assert rig.torn == exchanges
            await rig.assert_completes()
