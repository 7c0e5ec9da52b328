"""What a command line gets wrong is one line on stderr that names it, with a cause, and status 2."""

from pathlib import Path

import pytest

from tests.support.commands import ran
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
    ("markers {file} --dictionary DICT_9X9", "configuration.unknown_dictionary", "DICT_4X4_50"),
    ("markers {file} {file} --right {file}", "configuration.bad_pairs", "2 left pictures, but 1 right"),
    ("export urdf --set arm.dh=3 --out {tmp}/a.urdf", "configuration.tuple_type", "arm.yaml: dh = 3"),
    ("target --board 9x6 --size-mm 60 --out {tmp}/a.pdf", "refused.target.does_not_fit", "--size-mm"),
    ("target --marker 1000 --out {tmp}/a.pdf", "refused.target.number", "markers 0 to 999"),
    ("target --marker -1 --out {tmp}/a.pdf", "refused.target.number", "not -1"),
    ("target --marker 1 --dictionary DICT_9X9 --out {tmp}/a.pdf", "refused.target.dictionary", "DICT_9X9"),
    ("target --marker 1 --paper a9 --out {tmp}/a.pdf", "refused.target.paper", "'a9'"),
    ("target --board 9by6 --out {tmp}/a.pdf", "refused.target.board", "9by6"),
    ("target --board 9x7 --charuco --marker-mm 30 --out {tmp}/a.pdf", "refused.target.board", "do not fit"),
    (
        "target --board 12x12 --charuco --size-mm 10 --dictionary DICT_4X4_50 --out {tmp}/a.pdf",
        "refused.target.board", "72 markers are needed",
    ),
    ("target --board 9x6 --marker 1 --out {tmp}/a.pdf", "refused.target.which", "one of"),
    ("target --out {tmp}/a.pdf", "refused.target.which", "one of"),
    ("conformance reference --host no.such.host.invalid", "configuration.unknown_host", "'no.such.host."),
    ("conformance coupler --host no.such.host.invalid", "configuration.unknown_host", "'no.such.host."),
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
    done = ran(*(word.format(tmp=tmp_path, file=file) for word in words.split()), status=2)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith(f"longreach: {cause}: ")
    assert told in lines[0]
    assert {path.name for path in tmp_path.iterdir() if path.suffix} == set()
