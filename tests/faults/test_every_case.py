"""The list of forty: every fault case has a test whose name carries its number and its reaction."""

import re
from pathlib import Path

TESTS = Path(__file__).parents[1]
CASES = 40


def test_all_forty_fault_cases_are_covered() -> None:
    files = [*TESTS.glob("faults/test_*.py"), *TESTS.glob("integration/test_*.py")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    numbers = {
        int(number) for number in re.findall(r"^(?:async )?def test_case_(\d\d)_\w+", text, re.MULTILINE)
    }
    assert numbers == set(range(1, CASES + 1))
