"""How much memory and processor this process may have, and who says so: machine, container or process."""

import resource
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import psutil

_GROUPS = Path("/sys/fs/cgroup")
_V1 = {
    "memory.max": ("memory", "memory.limit_in_bytes"),
    "memory.current": ("memory", "memory.usage_in_bytes"),
}


class MemoryLimit(NamedTuple):
    """``bytes`` that ``whose`` still has, and what gives it more."""

    bytes: int
    whose: str
    advice: str


def least_memory(groups: Path | None = None) -> MemoryLimit:
    """The least of what machine, container (its cgroup is ``groups``) and process (RLIMIT_AS) still have."""
    return min(_memory_limits(groups or _own_group()), key=lambda limit: limit.bytes)


def cores_of_container(groups: Path | None = None) -> float | None:
    """How many processors' time the container may use; None where it is not limited."""
    groups = groups or _own_group()
    found = []
    for group in _within(groups):
        words = _text(group / "cpu.max").split()
        if not words:
            words = [_text(group / "cpu" / f"cpu.cfs_{name}_us") for name in ("quota", "period")]
        if len(words) == 2 and all(word.isdigit() for word in words):
            found.append(int(words[0]) / max(int(words[1]), 1))
    return min(found, default=None)


def _own_group() -> Path:
    """The directory of this process's cgroup; within a container that is the root."""
    own = _text(Path("/proc/self/cgroup")).partition("0::/")[2].splitlines()
    group = _GROUPS / own[0] if own else _GROUPS
    return group if (group / "memory.max").exists() else _GROUPS


def _within(group: Path) -> Iterator[Path]:
    """A cgroup and those around it: each limits what is in it (a Kubernetes pod, a systemd slice)."""
    yield group
    if _GROUPS in group.parents:
        yield from _within(group.parent)


def _memory_limits(groups: Path) -> Iterator[MemoryLimit]:
    yield MemoryLimit(psutil.virtual_memory().available, "this machine", "close something")
    for group in _within(groups):
        most, used = (_number(group, name) for name in ("memory.max", "memory.current"))
        if most is not None:
            whose = "this container" if group == groups else f"the control group {group.name or group}"
            advice = "raise its memory limit (cgroup memory.max)"
            yield MemoryLimit(max(most - (used or 0), 0), whose, advice)
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed != resource.RLIM_INFINITY:
        left = max(allowed - psutil.Process().memory_info().vms, 0)
        yield MemoryLimit(left, "this process", "raise its limit of address space (ulimit -v)")


def _number(groups: Path, name: str) -> int | None:
    """The number in a cgroup's file, of version 2 or 1; None where there is none, or no limit."""
    text = _text(groups / name) or _text(groups.joinpath(*_V1[name]))
    return int(text) if text.isdigit() else None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""
