"""Coverage-guided fuzzing of every decoder with atheris: ``python -m tests.fuzz.run --inputs 1000000``.

Each target runs in a process of its own, for libFuzzer never returns. Prints inputs, how many were accepted,
and the edges covered; the exit status is 0 only when nothing but typed refusals came.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.paths import ROOT

_NAMES = ("datagram", "session", "image", "modbus", "stream", "answer", "frame")
_INSTRUMENTED = ["protocol", "plant_emulator.core", "plant_emulator.shell"]


def fuzz(name: str, inputs: int, seed: int, corpus: Path) -> None:
    """Never returns: libFuzzer ends the process."""
    import atheris

    with atheris.instrument_imports(include=_INSTRUMENTED):
        from tests.fuzz.targets import TARGETS

    target, seeds = TARGETS[name]
    for number, data in enumerate(seeds):
        (corpus / f"seed-{number}").write_bytes(data)
    counts = [0, 0]

    def one(data: bytes) -> None:
        counts[target(data)] += 1
        if sum(counts) == inputs:
            print(f"{name} {inputs} {counts[1]}", flush=True)

    atheris.Setup([sys.argv[0], f"-runs={inputs}", f"-seed={seed}", "-max_len=1500", str(corpus)], one)
    atheris.Fuzz()


def fuzz_all(inputs: int, seed: int) -> bool:
    """Whether no target let anything but its refusal pass."""
    each, sound, covered = inputs // len(_NAMES), True, 0
    print(f"{'target':<10}{'inputs':>10}{'accepted':>10}{'edges':>8}  verdict")
    for name in _NAMES:
        with tempfile.TemporaryDirectory() as corpus:
            arguments = ["--target", name, "--inputs", str(each), "--seed", str(seed), "--corpus", corpus]
            done = subprocess.run(
                [sys.executable, "-m", "tests.fuzz.run", *arguments], cwd=ROOT, capture_output=True, text=True
            )
        accepted = re.search(rf"^{name} \d+ (\d+)$", done.stdout, re.MULTILINE)
        edges = [int(number) for number in re.findall(r"cov: (\d+)", done.stderr)]
        passed = done.returncode == 0 and accepted is not None
        sound &= passed
        covered += each if passed else 0
        shown = accepted.group(1) if accepted else "?"
        print(f"{name:<10}{each:>10}{shown:>10}{max(edges, default=0):>8}  {'pass' if passed else 'FAIL'}")
        if not passed:
            print(done.stderr[-3000:])
    print(f"{covered} inputs, nothing but typed refusals" if sound else "FAIL")
    return sound


def main() -> int:
    """The exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="over all targets")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--target", choices=_NAMES)
    parser.add_argument("--corpus", type=Path)
    arguments = parser.parse_args()
    if arguments.target is None:
        return 0 if fuzz_all(arguments.inputs, arguments.seed) else 1
    fuzz(arguments.target, arguments.inputs, arguments.seed, arguments.corpus)
    return 1


if __name__ == "__main__":
    sys.exit(main())
