"""Signs of life: given while the loop runs, to whom asked for them, and missed when it does not."""

import asyncio
import os
import time

import pytest

from foundation.service_main import LONGEST_SILENCE, SOCKET, Listener, signs_of_life

MS = 1_000_000


def listener(test: str) -> Listener:
    return Listener(f"longreach-test-{test}-{os.getpid()}", time.monotonic_ns())


def silence_ms(of: Listener) -> float:
    return of.silence_ns(time.monotonic_ns()) / MS


@pytest.mark.realtime
async def test_a_running_loop_gives_signs_and_a_busy_one_does_not() -> None:
    heard = listener("busy")
    environment = {SOCKET: heard.address, LONGEST_SILENCE: "40000"}
    async with signs_of_life(environment):
        await asyncio.sleep(0.3)
        assert silence_ms(heard) < 250.0
        began_ns = time.monotonic_ns()
        while time.monotonic_ns() - began_ns < 300 * MS:  # as a loop that is stuck
            pass
        assert silence_ms(heard) >= 290.0
    heard.close()


async def test_nothing_is_given_after_the_end() -> None:
    heard = listener("end")
    async with signs_of_life({SOCKET: heard.address, LONGEST_SILENCE: "20000"}):
        await asyncio.sleep(0.05)
    silence_ms(heard)
    await asyncio.sleep(0.2)
    assert silence_ms(heard) >= 190.0
    heard.close()
