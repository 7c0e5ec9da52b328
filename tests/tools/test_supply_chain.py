"""The bill of materials against the lock, and what an audit may call clean."""

from pathlib import Path
from typing import Any

import pytest

from tests.support.paths import ROOT
from tools.supply_chain import dependency_audit
from tools.supply_chain.bill_of_materials import differences
from tools.supply_chain.dependency_audit import CLEAN, NOT_AUDITED, VULNERABLE, verdict
from tools.supply_chain.requirements_lock import Pin, read_lock

A, B = "a" * 64, "b" * 64
PINS = [Pin("numpy", "2.4.6", frozenset({A, B})), Pin("scipy", "1.17.1", frozenset({A}))]


def component(name: str, version: str, *hashes: str) -> dict[str, Any]:
    found = [{"alg": "SHA-256", "content": each} for each in hashes]
    return {
        "name": name,
        "version": version,
        "externalReferences": [{"type": "distribution", "hashes": found}],
    }


def test_a_complete_document_has_no_differences() -> None:
    both = [component("numpy", "2.4.6", A, B), component("scipy", "1.17.1", A)]
    assert differences(PINS, {"components": both}) == []


@pytest.mark.parametrize(
    ("components", "said"),
    [
        ([component("numpy", "2.4.6", A, B)], "scipy 1.17.1: not in the document"),
        (
            [component("numpy", "2.4.6", A, B), component("scipy", "1.17.2", A)],
            "scipy 1.17.2: not in the lock",
        ),
        ([component("numpy", "2.4.6", A), component("scipy", "1.17.1", A)], "numpy 2.4.6: 1 hashes differ"),
        ([component("numpy", "2.4.6", A, B), {"name": "scipy", "version": "1.17.1"}], "1 hashes differ"),
    ],
)
def test_what_a_document_lacks_is_said(components: list[dict[str, Any]], said: str) -> None:
    assert any(said in line for line in differences(PINS, {"components": components}))


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock", "requirements-audit.lock"])
def test_every_line_of_a_lock_is_read(name: str) -> None:
    pins = read_lock(ROOT / name)
    text = (ROOT / name).read_text()
    assert len(pins) == sum("==" in line and not line.lstrip().startswith("#") for line in text.splitlines())
    assert sum(len(pin.hashes) for pin in pins) == text.count("--hash=sha256:")


def test_a_line_without_hash_is_refused(tmp_path: Path) -> None:
    lock = tmp_path / "x.lock"
    lock.write_text("numpy==2.4.6\n")
    with pytest.raises(ValueError, match="numpy"):
        read_lock(lock)


def looked_up(name: str, *ids: str) -> dict[str, Any]:
    return {"name": name, "version": "1", "vulns": [{"id": each, "fix_versions": ["2"]} for each in ids]}


SKIPPED = {"name": "b", "skip_reason": "Dependency not found on PyPI and could not be audited: b (1)"}


@pytest.mark.parametrize(
    ("parts", "status", "said"),
    [
        ([looked_up("a"), looked_up("b")], CLEAN, "2 of 2 packages looked up, 0 vulnerabilities"),
        ([looked_up("a", "CVE-1"), looked_up("b")], VULNERABLE, "a 1: CVE-1, fixed in 2"),
        ([looked_up("a"), SKIPPED], NOT_AUDITED, "NOT AUDITED: 1 packages"),
        ([looked_up("a", "CVE-1"), SKIPPED], VULNERABLE, "NOT AUDITED: 1 packages"),
        ([], NOT_AUDITED, "0 of 0"),
    ],
)
def test_what_could_not_be_looked_up_is_not_clean(parts: list[Any], status: int, said: str) -> None:
    found = verdict({"dependencies": parts})
    assert found.status == status
    assert said in "\n".join(found.lines)


def test_an_audit_that_crashes_is_no_audit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "pip-audit"
    broken.write_text("#!/bin/sh\necho 'cannot resolve host' >&2\nexit 1\n")
    broken.chmod(0o755)
    assert dependency_audit.main(str(broken), "requirements.lock") == NOT_AUDITED
    said = capsys.readouterr().out
    assert "cannot resolve host" in said
    assert "nothing is known" in said


@pytest.mark.parametrize("name", ["Makefile", "Dockerfile"])
def test_locks_are_installed_without_resolving_again(name: str) -> None:
    """A newer release of what is asked for by an extra would be taken for unpinned, and refused."""
    lines = [line for line in (ROOT / name).read_text().splitlines() if "--require-hashes" in line]
    assert lines
    assert all("--no-deps --require-hashes" in line for line in lines)
