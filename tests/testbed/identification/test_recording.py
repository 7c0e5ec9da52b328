"""Recordings for identification: written and read again, and every way in which one cannot serve named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from protocol.errors import ConfigurationError
from testbed.identification.excitation import FINE_STEP_MS, Piece, held_out, record, standard, words
from testbed.identification.recording import (
    Machine,
    MotionRecording,
    check_recording,
    read_recording,
    write_recording,
)

MACHINE = Machine("an arm", "0123456789abcdef", "servo")
CONFIGS = Path(__file__).parents[3] / "configs"


@pytest.fixture(scope="module")
def recorded() -> MotionRecording:
    config = load(PlantConfig, CONFIGS / "plant.yaml", {"step_ms": FINE_STEP_MS})
    return record(config, MACHINE, standard(0.005, (1, 2)), held_out(0.005, (1, 2))[:1], seed=3)


def test_a_recording_is_read_as_it_was_written(recorded: MotionRecording, tmp_path: Path) -> None:
    written = write_recording(tmp_path / "a.csv", recorded)
    read = read_recording(tmp_path / "a.csv")
    assert read.about == recorded.about
    assert read.sha256 == written.sha256 != ""
    for name in ("time_s", "valves", "angles", "pressures", "supply", "oil_degc"):
        np.testing.assert_allclose(getattr(read, name), getattr(recorded, name), rtol=2e-8, atol=1e-8)


def test_the_moved_joints_are_found(recorded: MotionRecording) -> None:
    assert check_recording(recorded, MACHINE) == [1, 2]


def test_columns_may_stand_in_any_order_and_be_more(recorded: MotionRecording, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_recording(path, recorded)
    lines = path.read_text().splitlines()
    turned = [
        line
        if line.startswith("#")
        else ",".join([*reversed(line.split(",")), "extra" if "t" in line else "7"])
        for line in lines
    ]
    path.write_text("\n".join(turned))
    np.testing.assert_allclose(read_recording(path).pressures, recorded.pressures, rtol=1e-8)


Change = Callable[[MotionRecording], MotionRecording]


def _with(name: str, where: Any, value: float) -> Change:
    def change(told: MotionRecording) -> MotionRecording:
        series = getattr(told, name).copy()
        series[where] = value
        return told._replace(**{name: series})

    return change


def _about(**changes: Any) -> Change:
    return lambda told: told._replace(about=told.about.model_copy(update=changes))


def _swapped(told: MotionRecording) -> MotionRecording:
    valves = told.valves.copy()
    valves[:, 1] *= -1.0
    return told._replace(valves=valves)


@pytest.mark.parametrize(
    ("change", "cause", "words_of_it"),
    [
        (_about(arm_hash="f" * 16), "recording.other_arm", "f" * 16),
        (_about(valve_set="mobile"), "recording.other_valve_set", "mobile valves"),
        (_with("pressures", (40, 1, 0), np.nan), "recording.not_finite", "lift_a_bar = nan at sample 40"),
        (_with("time_s", 50, 0.1), "recording.not_monotone", "0.1 follows 0.49 at sample 50"),
        (_with("time_s", 50, 0.505), "recording.uneven", "15.00 ms after sample 49"),
        (lambda told: told.part(0.0, 3.0), "recording.too_short", "3.0 s to fit"),
        (lambda told: told.part(0.0, 6.0), "recording.too_short", "0.0 s held out"),
        (_with("valves", slice(None), 0.0), "recording.no_excitation", "its valve word by 0.0000"),
        (_with("angles", slice(None), 0.1), "recording.no_excitation", "by 0.00 mrad"),
        (_with("pressures", (slice(None), 1, 1), 5e6), "recording.no_pressures", "lift_b_bar stands still"),
        (_with("valves", (10, 2), 0.01), "recording.no_rest", "a valve word of 0.01"),
        (_swapped, "recording.wrong_way", "lift follows the sign of its valve word in"),
    ],
)  # fmt: skip
def test_each_fault_of_a_recording_is_named(
    recorded: MotionRecording, change: Change, cause: str, words_of_it: str
) -> None:
    with pytest.raises(ConfigurationError, match=words_of_it) as caught:
        check_recording(change(recorded), MACHINE)
    assert caught.value.cause == cause


@pytest.mark.parametrize(
    ("edit", "cause", "words_of_it"),
    [
        (("# longreach recording 1", "# something"), "recording.not_one", "first line"),
        (("pressure_lift_a_bar", "p"), "recording.no_pressures", "pressure_lift_a_bar"),
        (("angle_tilt_rad", "q"), "recording.missing_column", "angle_tilt_rad"),
        (("\n0.01,", "\n7,8\n0.01,"), "recording.ragged", "has 2 cells, wanted 27"),
        (("\n0.01,", "\nzero,"), "recording.not_a_number", "'zero'"),
        (("# rest_s: 0.5", "# rest_s: -1"), "configuration.greater_than_equal", "rest_s"),
    ],
)  # fmt: skip
def test_each_fault_of_a_file_is_named(
    recorded: MotionRecording, tmp_path: Path, edit: tuple[str, str], cause: str, words_of_it: str
) -> None:
    path = tmp_path / "a.csv"
    write_recording(path, recorded)
    path.write_text(path.read_text().replace(*edit))
    with pytest.raises(ConfigurationError, match=words_of_it) as caught:
        read_recording(path)
    assert caught.value.cause == cause


def test_no_file_is_one_line() -> None:
    with pytest.raises(ConfigurationError, match=r"no/such\.csv: No such file"):
        read_recording(Path("no/such.csv"))


@pytest.mark.parametrize("kind", ["ramp", "step", "mixture"])
def test_every_piece_goes_as_far_one_way_as_the_other(kind: Any) -> None:
    table = words([Piece(kind, (0, 2), 0.2, 3.0, 7)], 0.01)
    assert np.abs(table[:, [0, 2]].sum(axis=0)).max() < 1e-9
    assert 0.1 < np.abs(table[:, [0, 2]]).max() <= 0.2 + 1e-12
    assert not table[:, [1, 3, 4, 5]].any()


def test_what_a_spreadsheet_saves_is_read(recorded: MotionRecording, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_recording(path, recorded)
    lines = path.read_text().splitlines()
    columns = len(lines[-1].split(","))
    about = [line for line in lines if line.startswith("#")]
    rows = lines[len(about) :]
    saved = "\r\n".join([*(line + "," * (columns - 1) for line in about), *rows])
    path.write_text(saved, encoding="utf-8-sig")
    assert read_recording(path).about == recorded.about
    german = [
        *(line + ";" * (columns - 1) for line in about),
        *(r.replace(",", ";").replace(".", ",") for r in rows),
    ]
    path.write_text("\r\n".join(german))
    np.testing.assert_allclose(read_recording(path).pressures, recorded.pressures, rtol=1e-8)
