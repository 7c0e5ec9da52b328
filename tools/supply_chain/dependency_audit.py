"""``python -m tools.supply_chain.dependency_audit PIP_AUDIT LOCK``: known vulnerabilities of what is locked.

Exit status 0: every package was looked up and none has one. 1: some have. 3: some could not be looked up,
which is not the same as having none; pip-audit itself ends with 0 then.
"""

import json
import subprocess
import sys
from typing import Any, NamedTuple

CLEAN, VULNERABLE, NOT_AUDITED = 0, 1, 3
_SERVICES = ("pypi", "osv")


class AuditVerdict(NamedTuple):
    """The exit status, and what is to be said."""

    status: int
    lines: list[str]


def verdict(report: dict[str, Any]) -> AuditVerdict:
    """What a report of pip-audit (its JSON) amounts to."""
    parts = report["dependencies"]
    skipped = [part for part in parts if "skip_reason" in part]
    found = [
        f"{part['name']} {part['version']}: {vulnerability['id']}, fixed in {fixed(vulnerability)}"
        for part in parts
        for vulnerability in part.get("vulns", ())
    ]
    lines = [
        *found,
        f"{len(parts) - len(skipped)} of {len(parts)} packages looked up, {len(found)} vulnerabilities",
    ]
    if skipped:
        lines.append(f"NOT AUDITED: {len(skipped)} packages, such as: {skipped[0]['skip_reason']}")
    if found:
        return AuditVerdict(VULNERABLE, lines)
    return AuditVerdict(NOT_AUDITED if skipped or not parts else CLEAN, lines)


def fixed(vulnerability: dict[str, Any]) -> str:
    """The versions that do not have it any more."""
    return ", ".join(vulnerability["fix_versions"]) or "no version"


def audited(pip_audit: str, lock: str, service: str) -> AuditVerdict:
    """The verdict by one database."""
    command = [pip_audit, "-s", service, "-r", lock, "--require-hashes", "--disable-pip", "--timeout", "10",
               "--progress-spinner", "off", "-f", "json"]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    try:
        return verdict(json.loads(done.stdout))
    except ValueError:
        why = done.stderr.strip().rpartition("\n")[2] or f"exit status {done.returncode}"
        return AuditVerdict(NOT_AUDITED, [f"NOT AUDITED: pip-audit gave no report: {why}"])


def main(pip_audit: str, lock: str) -> int:
    """Exit status, by the first database that answers for every package."""
    for service in _SERVICES:
        status, lines = audited(pip_audit, lock, service)
        print(*(f"{service}: {line}" for line in lines), sep="\n")
        if status != NOT_AUDITED:
            return status
    print("no database of vulnerabilities could be reached: nothing is known, which is not the same as none")
    return NOT_AUDITED


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
