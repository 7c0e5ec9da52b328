"""The smallest limit of memory and processors, and whose it is."""

from pathlib import Path

import pytest

from testbed.realtime import limits


def group(directory: Path, **files: str) -> Path:
    for name, text in files.items():
        (directory / name.replace("__", "/").replace("_dot_", ".")).parent.mkdir(parents=True, exist_ok=True)
        (directory / name.replace("__", "/").replace("_dot_", ".")).write_text(text + "\n")
    return directory


@pytest.mark.parametrize(
    "files",
    [
        {"memory_dot_max": str(512 << 20), "memory_dot_current": str(112 << 20)},
        {
            "memory__memory_dot_limit_in_bytes": str(512 << 20),
            "memory__memory_dot_usage_in_bytes": str(112 << 20),
        },
    ],
)
def test_a_containers_memory_is_the_least(tmp_path: Path, files: dict[str, str]) -> None:
    found = limits.least_memory(group(tmp_path, **files))
    assert (found.bytes, found.whose) == (400 << 20, "this container")
    assert "cgroup memory.max" in found.advice


def test_what_stands_around_a_container_limits_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "_GROUPS", tmp_path)
    pod = group(tmp_path / "pod", memory_dot_max=str(300 << 20), cpu_dot_max="150000 100000")
    inner = group(pod / "inner", memory_dot_max=str(512 << 20), cpu_dot_max="max 100000")
    assert limits.least_memory(inner)[:2] == (300 << 20, "the control group pod")
    assert limits.cores_of_container(inner) == 1.5


def test_a_limit_of_the_process_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits.resource, "getrlimit", lambda _: (1, 1))
    assert limits.least_memory(group(tmp_path, memory_dot_max="max")).whose == "this process"
    monkeypatch.setattr(limits.resource, "getrlimit", lambda _: (limits.resource.RLIM_INFINITY,) * 2)
    assert limits.least_memory(tmp_path).whose == "this machine"


def test_a_containers_processors_are_counted(tmp_path: Path) -> None:
    assert limits.cores_of_container(tmp_path) is None
    assert limits.cores_of_container(group(tmp_path / "a", cpu_dot_max="max 100000")) is None
    assert limits.cores_of_container(group(tmp_path / "b", cpu_dot_max="50000 100000")) == 0.5
