"""What a command line gets wrong is one line on stderr that names it, with a cause, and status 2."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from testbed.cli.main import app
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow("new interpreters, one a command")

WRONG = (  # command, cause, what the line says beside it
    ("dmeo", "usage.unknown_command", "did you mean 'demo'?"),
    ("demo --sed 3", "usage.unknown_option", "--seed"),
    ("demo --seed x", "usage.bad_value", "'--seed' = x: a whole number in decimal digits is wanted"),
    ("demo --looks 99", "usage.bad_value", "less than or equal to 9"),
    ("demo 3", "usage.wrong", "(3)"),
    ("demo --lockstep --config-dir /nosuch", "configuration.no_directory", "/nosuch"),
    ("demo --lockstep --scenario stadnard", "configuration.unknown_scenario", "known: drill_face"),
    ("demo --lockstep --arm long_cran", "configuration.unknown_arm", "did you mean long_crane?"),
    ("demo --lockstep --set mass", "configuration.bad_override", "FILE.KEY"),
    ("demo --lockstep --set plnt.a=3", "configuration.unknown_file", "known: arm, controller"),
    ("demo --lockstep --set plant.payload.mas_kg=3", "configuration.unknown_key", "did you mean mass_kg?"),
    ("demo --lockstep --set plant.payload.mass_kg=x", "configuration.number", "payload.mass_kg = 'x'"),
    ("experiment positioning --world lba", "usage.bad_value", "'lab', 'real'"),
    ("experiment parking --scheduler here --out {tmp}/a", "configuration.bad_address", "tcp:"),
    ("experiment hole-drives --count 1 --out {file}/x", "output.unwritable", "file/x"),
    ("recording info", "usage.missing", "'FILE'"),
    ("recording info /nosuch.mcap", "system.refused", "/nosuch.mcap: No such file"),
    ("recording info {file}", "recording.no_recording", "MCAP"),
    ("arm check nosuch", "configuration.unknown_arm", "known: default"),
    ("camera check /nosuch", "configuration.no_recording", "no such directory, film or device"),
    ("hand-eye solve {file}", "refused.hand_eye.unreadable", "not JSON"),
    ("hand-eye intrinsics {file}", "configuration.bad_recording", "no picture"),
    ("hand-eye session list --url nonsense", "link.rest", "nonsense"),
    ("commission --joints slw --out {tmp}/b", "configuration.unknown_joint", "known: slew, lift"),
    ("markers {file}", "configuration.bad_recording", "no picture"),
    ("odometry --left /none --right /none --calib /none", "configuration.bad_sequence", "/none: no such"),
    ("experiment positioning --looks 3", "usage.bad_value", "not an option of --method corrected"),
    ("conformance reference --case 9999", "conformance.unknown_case", "see --list"),
    ("conformance coupler --profile nosuch", "conformance.unknown_part", "no such part; there are paths"),
    ("init {tmp}", "configuration.not_empty", "nothing was copied"),
    ("token new {file}", "configuration.secret_exists", "there already"),
)  # fmt: skip


@pytest.mark.parametrize(("words", "cause", "told"), WRONG, ids=[words for words, _, _ in WRONG])
def test_what_is_wrong_is_one_line_that_names_it(
    words: str, cause: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    file = tmp_path / "file"
    file.write_text("neither JSON, nor pictures, nor a directory\n")
    done = CliRunner().invoke(app, [word.format(tmp=tmp_path, file=file) for word in words.split()])
    assert done.exit_code == 2, done.output
    lines = done.stderr.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith(f"longreach: {cause}: ")
    assert told in lines[0]
