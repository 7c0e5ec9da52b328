"""Ctrl-C waits for the end of what it must not break into."""

import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from foundation.compiled import interrupt_later, kernel


@pytest.fixture(autouse=True)
def _as_at_a_terminal() -> Iterator[None]:
    """A shell ignores Ctrl-C for what it puts in the background, and children inherit that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def press_ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_it_comes_after_the_block_and_as_ever_after_that() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012  the end of the block is what raises
        with interrupt_later():
            with interrupt_later():
                press_ctrl_c()
                done.append("inner")
            done.append("outer")
        done.append("beyond")
    assert done == ["inner", "outer"]
    with pytest.raises(KeyboardInterrupt):
        press_ctrl_c()


def test_other_threads_run_it_as_it_is() -> None:
    ran: list[bool] = []

    def work() -> None:
        with interrupt_later():
            ran.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert ran == [True]


def test_a_kernel_is_loaded_before_ctrl_c_ends_its_first_call(monkeypatch: pytest.MonkeyPatch) -> None:
    @kernel
    def doubled(x: float) -> float:
        return 2.0 * x

    load = type(doubled._cache).load_overload

    def interrupted(*arguments: object) -> object:
        press_ctrl_c()
        return load(*arguments)

    monkeypatch.setattr(type(doubled._cache), "load_overload", interrupted)
    with pytest.raises(KeyboardInterrupt):
        doubled(1.0)
    assert len(doubled.signatures) == 1, "it was loaded all the same"
    assert np.isclose(doubled(1.0), 2.0)
