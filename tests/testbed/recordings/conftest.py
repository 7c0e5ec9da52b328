"""One run, recorded with every pixel, for all tests of what is made of recordings."""

import pytest

from tests.testbed.lockstep.recorded_run import RecordedRun, recorded_run


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return recorded_run(tmp_path_factory.mktemp("run"), images="raw")
