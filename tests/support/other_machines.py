"""Runs the numerical tests as other processors compute, and with inputs that are off in the ninth digit.

    python -m tests.support.other_machines            every machine, then disturbances 1 to 5
    python -m tests.support.other_machines --today    one machine and one disturbance, others each day
    python -m tests.support.other_machines haswell 3  these

A machine is a set of variables: the processor that numba compiles for, OpenBLAS' kernel, and the instructions
that numpy, OpenCV and the C library may not use. Each has a cache of compiled kernels of its own. Before its
tests, the libraries are listed in which its last digits differ. A machine whose instructions this
processor lacks is named and not tried. Exit status 1: tests failed.
"""

import datetime
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from testbed.reporting.console import out
from tests.support.paths import ROOT

NUMERICAL = (
    "tests/nominal_arm",
    "tests/controller",
    "tests/plant_emulator",
    "tests/vision_pc",
    "tests/testbed/lockstep",
    "tests/testbed/test_lockstep_repeats.py",
)
MARKS = "not realtime and not experiment and not bench and not docker"
DISTURBANCES = ("1", "2", "3", "4", "5")
_AVX512 = "-avx512f,-avx512vl,-avx512bw,-avx512dq,-avx512cd"
MACHINES: dict[str, dict[str, str]] = {
    "haswell": {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": f"+avx2,+fma,{_AVX512}",
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4",
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F",
    },
    "zen": {
        "NUMBA_CPU_NAME": "znver2",
        "NUMBA_CPU_FEATURES": f"+avx2,+fma,{_AVX512}",
        "OPENBLAS_CORETYPE": "Zen",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4",
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F",
    },
    "skylake": {
        "NUMBA_CPU_NAME": "skylake-avx512",
        "NUMBA_CPU_FEATURES": "+avx2,+fma,+avx512f,+avx512vl",
        "OPENBLAS_CORETYPE": "SkylakeX",
    },
    "nehalem": {
        "NUMBA_CPU_NAME": "nehalem",
        "NUMBA_CPU_FEATURES": f"+sse4.2,-avx,-avx2,-fma,{_AVX512}",
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4",
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,AVX",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4,-AVX512F",
    },
}
_INSTRUCTIONS: dict[
    str, set[str]
] = {  # what numba's and OpenBLAS' code for the machine executes, as Linux names it
    "haswell": {"avx2", "fma", "bmi2"},
    "zen": {"avx2", "fma", "bmi2"},
    "skylake": {"avx2", "fma", "bmi2", "avx512f", "avx512vl", "avx512bw", "avx512dq", "avx512cd"},
    "nehalem": {"sse4_2"},
}
_DIGITS = """
import hashlib, json, math
import cv2, numpy as np
def digest(values): return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
A = np.random.default_rng(1).normal(size=(67, 67))
picture = np.random.default_rng(1).normal(size=(200, 300)).astype(np.float32)
print(json.dumps({
    "BLAS": digest(np.linalg.solve(A, A @ A)), "numpy": digest([np.sin(A), np.exp(A), np.tanh(A)]),
    "OpenCV": digest(cv2.GaussianBlur(picture, (0, 0), 1.3)),
    "C library": digest([[f(x) for x in A.ravel()] for f in (math.sin, math.exp, math.atan)]),
}))
"""


class Outcome(NamedTuple):
    """One run of the tests: what pytest counted, and the names of those that failed."""

    counted: str
    failed: list[str]
    seconds: float


def surroundings(name: str) -> dict[str, str]:
    """The variables of the process that stands for machine ``name``; of this machine for a disturbance."""
    variables = MACHINES.get(name, {})
    cache = {"NUMBA_CACHE_DIR": str(Path(sys.prefix) / "other-machines" / name)} if variables else {}
    return {**os.environ, **variables, **cache}


def different_digits(name: str) -> str:
    """In which libraries the last digits of machine ``name`` differ from this machine's."""
    here, there = (
        json.loads(subprocess.check_output([sys.executable, "-c", _DIGITS], env=env, text=True))
        for env in (dict(os.environ), surroundings(name))
    )
    return ", ".join(library for library in here if here[library] != there[library]) or "none"


def run(name: str, processes: str) -> Outcome:
    """The numerical tests on machine ``name``, or with the disturbance of that number."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", processes, "--dist", "loadfile", "-m", MARKS]
    if name in DISTURBANCES:
        command += ["-p", "tests.support.disturbed", "--disturb", name]
    began_s = time.monotonic()
    done = subprocess.run(
        [*command, *NUMERICAL], cwd=ROOT, env=surroundings(name), capture_output=True, text=True, check=False
    )
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    counted = re.findall(r"^=* ?(\d.*) in [\d.]+s", done.stdout, re.MULTILINE)
    if not counted or (done.returncode and not failed):
        failed.append(f"status {done.returncode}: {(done.stdout + done.stderr)[-2000:]}")
    return Outcome(counted[-1] if counted else "none ran", failed, time.monotonic() - began_s)


def own_instructions() -> set[str]:
    """The instruction sets of this processor as Linux names them; none on another operating system."""
    try:
        return set(re.findall(r"\S+", Path("/proc/cpuinfo").read_text("utf-8")))
    except FileNotFoundError:
        return set()


def lacking(name: str, own: set[str]) -> str:
    """The instructions that machine ``name`` executes and a processor with ``own`` has not; else empty."""
    return ", ".join(sorted(_INSTRUCTIONS.get(name, set()) - own))


def of_today(day: int, own: set[str]) -> list[str]:
    """By the day's number, a machine that a processor with ``own`` can stand for, and a disturbance."""
    possible = [name for name in MACHINES if not lacking(name, own)]
    machine = [possible[day % len(possible)]] if possible else []
    return [*machine, DISTURBANCES[day % len(DISTURBANCES)]]


def main(*asked: str) -> int:
    """Exit status: 0 when all passed."""
    own = own_instructions()
    names = list(asked) or [*MACHINES, *DISTURBANCES]
    if asked == ("--today",):
        names = of_today(datetime.date.today().toordinal(), own)
    if unknown := set(names) - {*MACHINES, *DISTURBANCES}:
        out.print(f"{sorted(unknown)[0]}: one of {', '.join([*MACHINES, *DISTURBANCES])} is expected")
        return 2
    table = Table("machine or disturbance", "last digits differ in", "tests", "s", title="numerical tests")
    failed = []
    for name in names:
        if absent := lacking(name, own):
            table.add_row(name, f"this processor has no {absent}", "not tried", "0")
            continue
        digits = "inputs, by 1e-9" if name in DISTURBANCES else different_digits(name)
        outcome = run(name, os.environ.get("PROCESSES", "2"))
        table.add_row(name, digits, outcome.counted, f"{outcome.seconds:.0f}")
        failed += [f"{name}: {test}" for test in outcome.failed]
    out.print(table)
    for one in failed:
        out.print(one, markup=False, highlight=False, soft_wrap=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
