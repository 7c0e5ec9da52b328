"""``run.json`` of a run: command, code, machine and configuration that made it, and how it ended."""

import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from foundation.command_options import shipped_configs
from foundation.foreign_text import parse_json
from testbed.reporting.console import plain
from testbed.scenarios.scenario import Settings, load_settings

RECORD_FILE = "run.json"
FORMAT = 1
_UTC = "%Y-%m-%dT%H:%M:%SZ"
LIBRARIES = (
    "longreach",
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "opencv-python-headless",
    "clarabel",
    "ruckig",
)
_TYPES: dict[str, Any] = {
    "took_s": (int, float),
    "process": int,
    "command": list,
    "machine": dict,
    "changed": dict,
}
_ROOT = Path(__file__).parents[2]


class KeptRun(NamedTuple):
    """A run's directory and what its ``run.json`` says; ``facts`` is empty where there is none to read."""

    directory: Path
    facts: Mapping[str, Any]

    @property
    def command(self) -> str:
        """The command line, as typed in a shell."""
        return " ".join(self.facts.get("command", ())) or "–"

    @property
    def began(self) -> str:
        """When it began, UTC; by its directory's name, a local time, where no record says."""
        began = self.facts.get("began")
        if isinstance(began, str):
            return began
        local_s = time.mktime(time.strptime(self.directory.name[: len("20260101-000000")], "%Y%m%d-%H%M%S"))
        return time.strftime(_UTC, time.gmtime(local_s))

    @property
    def code(self) -> str:
        """Version and commit; a ``+`` where files differed from it."""
        commit = str(self.facts.get("commit") or "")[:10]
        changed = "+" if self.facts.get("uncommitted") else ""
        return " ".join(filter(None, (self.facts.get("version", ""), commit + changed))) or "–"

    @property
    def ending(self) -> str:
        """How it ended: its verdict, what stopped it, or that it has not ended."""
        if not self.facts:
            return "no record"
        if "took_s" not in self.facts:
            return "running" if self.is_running else "cut off"
        return self.facts.get("verdict") or self.facts.get("ended_by") or "ended"

    @property
    def is_running(self) -> bool:
        """Whether the process that makes it is alive."""
        pid = self.facts.get("process", 0)
        return "took_s" not in self.facts and pid > 0 and Path(f"/proc/{pid}").exists()

    @property
    def size_mb(self) -> float:
        """What it takes on the disk."""
        return 1e-6 * sum(file.stat().st_size for file in self.directory.rglob("*") if file.is_file())


def beginning() -> dict[str, Any]:
    """What is known of a run before anything has run."""
    commit, uncommitted = _commit()
    return {
        "format": FORMAT,
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "began": time.strftime(_UTC, time.gmtime()),
        "process": os.getpid(),
        "version": library_versions()["longreach"],
        "commit": commit,
        "uncommitted": uncommitted,
        "libraries": library_versions(),
        "machine": machine(),
    }


def note(directory: Path, **facts: Any) -> None:
    """Add ``facts`` to the record of a run, which is made where there is none."""
    text = json.dumps({**read(directory).facts, **plain(facts)}, indent=2, ensure_ascii=False)
    partial = directory / f"{RECORD_FILE}.part"
    partial.write_text(text + "\n", encoding="utf-8")
    partial.replace(directory / RECORD_FILE)


def read(directory: Path) -> KeptRun:
    """The record in ``directory``; without facts where there is none, or none that can be read."""
    try:
        facts = parse_json((directory / RECORD_FILE).read_text(encoding="utf-8"))
    except OSError:
        return KeptRun(directory, {})
    except ValueError:
        facts = None
    sound = isinstance(facts, dict) and all(isinstance(facts[k], t) for k, t in _TYPES.items() if k in facts)
    return KeptRun(directory, facts if sound else {"took_s": 0.0, "ended_by": f"{RECORD_FILE} is damaged"})


def note_settings(directory: Path, used: Settings) -> None:
    """Add where ``used`` differs from what is shipped."""
    note(directory, changed=changed_settings(used, load_settings(shipped_configs(), {})))


def changed_settings(used: Settings, shipped: Settings) -> dict[str, tuple[Any, Any]]:
    """``file.key`` → (as shipped, as used), for each value in which two configurations differ."""
    before, after = _flat(shipped), _flat(used)
    keys = sorted(before.keys() | after.keys())
    return {key: (before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def _flat(settings: Settings) -> dict[str, Any]:
    flat: dict[str, Any] = {}

    def spread(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                spread(f"{prefix}.{key}", item)
        else:
            flat[prefix] = value

    for name, model in settings._asdict().items():
        spread(name, model.model_dump(mode="json"))
    return flat


@cache
def library_versions() -> dict[str, str]:
    """Name → version, as installed here; empty for what is not installed."""
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = ""
    return versions


def machine() -> dict[str, Any]:
    """The processor's name, how many of them this process may use, and the kernel."""
    processor = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "processor": processor or platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "kernel": f"{platform.system()} {platform.release()}",
    }


@cache
def _commit() -> tuple[str, bool]:
    """The commit of the checkout that this runs from, and whether files differ; empty outside of one."""
    if not (_ROOT / ".git").exists():
        return "", False
    try:
        commit, status = (
            subprocess.run(
                ["git", "-C", str(_ROOT), *words], capture_output=True, text=True, timeout=10.0, check=True
            ).stdout.strip()
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        )
    except (OSError, subprocess.SubprocessError):
        return "", False
    return commit, bool(status)
