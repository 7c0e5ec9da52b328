"""`longreach replay`: vision's recording run again, compared to the last bit."""

import time
from pathlib import Path

from foundation.recording.beginning import session_entries
from testbed.recordings.comparison import ALIKE, ReplayComparison
from testbed.recordings.perception_replay import PerceptionReplay, pixels_for
from testbed.recordings.pixels import RenderedPixels
from testbed.recordings.recorded_vision import RecordedVision, recorded_vision
from testbed.reporting.console import out, write_json


def run_replay(file: Path, truth: Path | None = None, json_file: Path | None = None) -> bool:
    """Whether all of vision's recording ``file`` came out again as it was recorded.

    ``truth``: as for ``pixels_for``. Raises RecordingUnreadable, ConfigurationError, OSError.
    """
    recording = recorded_vision(file)
    pixels = pixels_for(recording, truth)
    replay = PerceptionReplay(recording, pixels)
    began_s = time.process_time()
    compared = replay.run()
    took_s = time.process_time() - began_s
    made = "rendered again" if isinstance(pixels, RenderedPixels) else "as recorded"
    out.print(
        f"{replay.recorded_s:.1f} s of arm time in {took_s:.1f} s of one core; pixels {made}", highlight=False
    )
    _show_compared(compared, recording)
    for damage in replay.damages:
        out.print(f"not read, at byte {damage.offset}: {damage.what}", highlight=False)
    results = {
        "recorded_s": replay.recorded_s, "cpu_s": took_s, "pixels": made, "exact": compared.exact,
        "alike": dict(compared.alike), "of": dict(compared.of), "largest_difference": compared.largest,
        "first_difference": None if compared.first is None else compared.first._asdict(),
        "damages": [damage._asdict() for damage in replay.damages],
    }  # fmt: skip
    write_json(json_file, results)
    return compared.identical and not replay.damages


def _show_compared(compared: ReplayComparison, recording: RecordedVision) -> None:
    word = "identical" if recording.exact else f"alike within {ALIKE:g}"
    for kind, count in compared.of.items():
        out.print(f"{kind}: {compared.alike[kind]} of {count} {word}", highlight=False)
    if compared.first is not None:
        out.print(f"first difference: {compared.first.in_words()}", highlight=False, soft_wrap=True)
    if not recording.exact:
        versions = _versions(recording)
        out.print(f"not compared to the last bit, as versions differ: {versions}", highlight=False)


def _versions(recording: RecordedVision) -> str:
    here = session_entries("vision_pc", {})
    differing = [name for name in here if name.startswith("version") or name == "machine"]
    parts = [
        f"{name.removeprefix('version ')} {recording.session.get(name, 'unknown')}, here {here[name]}"
        for name in differing
        if recording.session.get(name) != here[name]
    ]
    return "; ".join(parts)
