"""The doctor finds what is there and names what is wrong."""

import json
import os
import socket
from pathlib import Path

import pytest

from foundation.configuration import read_yaml
from testbed.cli.doctor import examine
from testbed.realtime import doctor
from testbed.realtime.launch import PortUse
from tests.support.paths import ROOT, copied_configs


def test_this_machine_is_examined_without_a_failure(tmp_path: Path) -> None:
    checks = {
        check.name: check for check in doctor.machine_checks(ROOT / "requirements.lock", tmp_path / "runs")
    }
    assert [name for name, check in checks.items() if check.verdict == "failed"] == []
    assert "as locked" in checks["packages"].found
    assert "p50/p99" in checks["timer"].found


@pytest.mark.parametrize(
    ("found", "verdict"), [((3, 10), "failed"), ((3, 11), "ok"), ((3, 13), "ok"), ((3, 14), "failed")]
)
def test_the_pythons_of_the_lock_pass_and_others_are_told_the_limit(
    monkeypatch: pytest.MonkeyPatch, found: tuple[int, int], verdict: str
) -> None:
    monkeypatch.setattr(doctor.sys, "version_info", (*found, 0, "final", 0))
    check = doctor.python_check()
    assert check.verdict == verdict
    assert ("3.11, 3.12 or 3.13" in check.advice) == (verdict == "failed")


def test_a_package_of_another_version_is_named(tmp_path: Path) -> None:
    lock = tmp_path / "requirements.lock"
    lock.write_text("numpy==0.0.1 \\\n    --hash=sha256:00\nno-such-package==1.0 \\\n    --hash=sha256:00\n")
    check = doctor.versions_check(lock)
    assert check.verdict == "failed"
    assert "instead of 0.0.1" in check.found
    assert "no-such-package missing" in check.found


def test_a_taken_port_is_named_with_its_kind() -> None:
    for kind, word in ((socket.SOCK_STREAM, "tcp"), (socket.SOCK_DGRAM, "udp")):
        with socket.socket(socket.AF_INET, kind) as holder:
            holder.bind(("127.0.0.1", 0))
            if kind == socket.SOCK_STREAM:
                holder.listen()
            port = holder.getsockname()[1]
            use = PortUse("rest", "127.0.0.1", port, kind, "vision.api.port")
            taken = doctor.port_check(use)
            assert taken.verdict == "failed"
            assert f"127.0.0.1:{port}/{word}: Address already in use" in taken.found
            assert f"held by process {os.getpid()} (" in taken.found
        assert doctor.port_check(use).verdict == "ok"


def test_a_wrong_configuration_file_is_quoted(tmp_path: Path) -> None:
    path = tmp_path / "plant.yaml"
    path.write_text("a: [1\n")
    check = doctor.configuration_check("plant", lambda: read_yaml(path))
    assert check.verdict == "failed"
    assert "plant.yaml" in check.found
    assert "\n" not in check.found


def test_a_drawing_that_is_not_of_the_machine_is_named_and_no_shipped_arm_is(tmp_path: Path) -> None:
    """A longer boom in arm.yaml alone is a valid file, and sends the tool 0.2 m beside."""
    configs = copied_configs(tmp_path / "configs")
    assert drawing(configs, tmp_path)["verdict"] == "ok"
    assert drawing(configs / "arms" / "rock_breaker", tmp_path)["verdict"] == "ok"
    arm = configs / "arm.yaml"
    arm.write_text(arm.read_text().replace("a_m: 1.5999981865314723", "a_m: 1.80"))
    told = drawing(configs, tmp_path)
    assert (told["verdict"], told["found"]) == ("warning", "boom: drawn 1.8 m, built 1.6 m")


def drawing(configs: Path, tmp_path: Path) -> dict[str, str]:
    figures = tmp_path / "doctor.json"
    examine(configs, [], tmp_path / "runs", figures)
    (row,) = (row for row in json.loads(figures.read_text())["checks"] if row["name"] == "drawing")
    return row  # type: ignore[no-any-return]
