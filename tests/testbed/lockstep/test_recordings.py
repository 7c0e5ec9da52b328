"""Lockstep records all three parts; other people's reader finds the looks, the pixels and one session."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.testbed.lockstep.recorded_run import FILES, RecordedRun, recorded_run
from vision_pc.shell.recording import vision_recorder as topics


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    return recorded_run(tmp_path_factory.mktemp("run"), images="raw")


def decoded(path: Path) -> dict[str, list[Any]]:
    """All messages by topic, as the library of the format's makers decodes them."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, said in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(said)
    return found


def metadata(path: Path) -> dict[str, dict[str, str]]:
    with path.open("rb") as stream:
        return {record.name: record.metadata for record in make_reader(stream).iter_metadata()}


def test_all_three_files_are_of_one_session_and_say_what_they_ran_with(recorded: RecordedRun) -> None:
    said = [metadata(recorded.directory / name) for name in FILES]
    assert [each["session"]["id"] for each in said] == ["session 7"] * 3
    assert [each["session"]["service"] for each in said] == ["plant_emulator", "controller", "vision_pc"]
    keys = [set(json.loads(each["run"]["configuration"])) for each in said]
    assert keys == [{"plant", "scene"}, {"arm", "controller"}, {"arm", "vision"}]


def test_looks_frames_and_references_are_there_to_the_last_bit(recorded: RecordedRun) -> None:
    said = decoded(recorded.directory / FILES[2])
    assert len(said[topics.LOOK]) == 2
    for message, look in zip(said[topics.LOOK], recorded.looks, strict=True):
        assert np.array_equal(np.reshape(message.X_CO, (4, 4)), look.X_CO)
        assert np.array_equal(np.reshape(message.cov_CM, (6, 6)), look.cov_CM)
    numbers = [message.number for message in said[topics.OBSERVATION]]
    assert numbers == list(range(1, len(numbers) + 1))
    assert list(said[topics.LOOK][0].observations) == [1, 2]
    assert list(said[topics.LOOK][1].observations) == [numbers[-1]]
    chain = [message.previous for message in said[topics.OBSERVATION]]
    assert chain[1:] == numbers[:-1]
    assert not said[topics.OBSERVATION][0].HasField("previous")
    assert len(said[topics.ODOMETRY]) == len(numbers) - 3
    kinds = [message.kind for message in said[topics.REFERENCE]]
    assert kinds == ["Command", "ReferencePose"]
    assert len(said[topics.PATH][0].poses) == 1
    assert len(said[topics.CLOCK]) >= 1


def test_a_recorded_run_is_the_same_run(recorded: RecordedRun) -> None:
    assert recorded_run(None).digest == recorded.digest
