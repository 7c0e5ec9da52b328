"""What every test may ask for."""

import signal
from collections.abc import Iterator
from pathlib import Path

import cv2
import hypothesis
import pytest

from testbed.scenarios.scenario import Settings, load_settings
from tests.support.paths import CONFIGS

pytest_plugins = ["tests.support.real_time"]

# Properties hold whatever else the machine does: no example has a deadline on the wall clock. No change is
# judged by chance: a test has the same examples in every run; `--hypothesis-profile=search` draws others.
hypothesis.settings.register_profile("search", deadline=None, derandomize=False)
hypothesis.settings.register_profile("longreach", deadline=None, derandomize=True)
hypothesis.settings.load_profile("longreach")

# A job in the background of a shell without job control ignores Ctrl-C, and so would all that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def config_dir() -> Path:
    """The folder of the configuration files as shipped."""
    return CONFIGS


@pytest.fixture(scope="session")
def shipped_settings() -> Settings:
    """Every configuration file as shipped, read once."""
    return load_settings(CONFIGS, {})


@pytest.fixture
def one_core() -> Iterator[None]:
    """What benchmarks ask for: OpenCV on one thread, as its peers here."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)
