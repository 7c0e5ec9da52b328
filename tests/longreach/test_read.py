"""``longreach.read``: what was recorded comes back as arrays, also of a file that was cut off."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

import longreach
from longreach.replaying import Replay
from protocol.errors import RequestRefused
from testbed.recordings.plant_truth import read_truth
from tests.support.paths import CONFIGS

pytestmark = pytest.mark.slow("a run is recorded")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lockstep run of two seconds, recorded by all three parts."""
    directory = tmp_path_factory.mktemp("run")
    with longreach.lockstep(seed=1, config_dir=CONFIGS) as rig:
        recordings = rig.lockstep_rig.record_in(directory, "read")
        rig.enable()
        rig.run("move", offset_base_m=[0.0, 0.0, 0.02])
        recordings.close()
    return directory


def test_truth_comes_back_bit_by_bit(run: Path) -> None:
    (file,) = run.rglob("truth.mcap")
    recorded, expected = longreach.read(file), read_truth(file)
    truth = recorded["/plant/truth"]
    assert recorded.complete
    assert not recorded.damages
    assert truth["X_WT"].shape == (len(truth.log_ns), 4, 4)
    assert truth["q_lift_rad"].shape == truth.log_ns.shape
    at = {record.truth.time_ns: record.truth for record in expected.truths}
    for time_ns, X_WT, q in zip(truth["time_ns"], truth["X_WT"], truth["q_lift_rad"], strict=True):
        np.testing.assert_array_equal(X_WT, at[time_ns].X_WT)
        assert q == at[time_ns].q[1]
    assert truth["X_WT"][-1, 2, 3] - truth["X_WT"][0, 2, 3] == pytest.approx(0.02, abs=0.005)


def test_every_part_can_be_read_and_topics_chosen(run: Path) -> None:
    for file in run.rglob("*.mcap"):
        told = longreach.read(file)
        assert len(told) > 2, file
        for topic in told.values():
            assert all(len(column) == len(topic.log_ns) for column in topic.columns.values())
            assert np.all(np.diff(topic.log_ns) >= 0)
    (file,) = run.rglob("truth.mcap")
    assert list(longreach.read(file, ["/plant/truth"])) == ["/plant/truth"]
    with pytest.raises(RequestRefused, match=r"truth.mcap: no topic /nosuch; there are .*/plant/truth"):
        longreach.read(file, ["/nosuch"])
    with pytest.raises(KeyError, match="no X; there are"):
        longreach.read(file)["/plant/truth"]["X"]


def test_what_was_cut_off_is_read_up_to_the_cut(run: Path, tmp_path: Path) -> None:
    (file,) = run.rglob("truth.mcap")
    whole = longreach.read(file)["/plant/truth"]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 4])
    told = longreach.read(cut)
    assert not told.complete
    assert told.damages
    part = told["/plant/truth"]
    assert 0 < len(part.log_ns) < len(whole.log_ns)
    np.testing.assert_array_equal(part["X_WT"], whole["X_WT"][: len(part.log_ns)])


@pytest.mark.parametrize(("alike", "damages", "identical"), [(3, 0, True), (2, 0, False), (3, 1, False)])
def test_a_damaged_recording_is_no_identical_one(alike: int, damages: int, identical: bool) -> None:
    assert Replay({"look": alike}, {"look": 3}, "", damages).identical is identical


def test_what_others_wrote_comes_back_whole(tmp_path: Path) -> None:
    """One topic on two channels, truth values beside numbers, a number here and a list there."""
    with (tmp_path / "merged.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channels = [writer.register_channel("/a", "json", schema) for _ in range(2)]
        said = (b'{"a": 5, "b": true}', b'{"a": [1, 2], "b": 5}', b'{"a": 7, "b": false}')
        for number, data in enumerate(said):
            writer.add_message(channels[number % 2], number, data, number)
        writer.finish()
    topic = longreach.read(tmp_path / "merged.mcap")["/a"]
    assert topic.log_ns.tolist() == [0, 1, 2]
    assert topic["b"].tolist() == [True, 5, False]
    assert topic["b"][0] is True
    np.testing.assert_array_equal(topic["a"], [5, np.nan, 7])
    np.testing.assert_array_equal(topic["a[1]"], [np.nan, 2, np.nan])
