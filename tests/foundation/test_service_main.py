"""How every service starts and ends: arguments, refusals in one line, bugs on record, version, ports."""

import asyncio
import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from foundation.event_log import EventLog
from foundation.secret_source import bound_tcp, bound_udp
from foundation.service_main import RECORDS, ServiceOptions, ServiceProgram, Switch, service_main
from protocol.errors import ConfigurationError, LinkLost

Body = Callable[[EventLog], int]


class Made:
    """A service that runs ``body`` and remembers what it was made with."""

    def __init__(self, body: Body) -> None:
        self.options: ServiceOptions | None = None
        self._log: EventLog | None = None
        self._body = body

    def make(self, options: ServiceOptions, log: EventLog) -> "Made":
        self.options, self._log = options, log
        return self

    async def run(self) -> int:
        assert self._log is not None
        await asyncio.sleep(0)
        return self._body(self._log)


def program(made: Made) -> ServiceProgram:
    switch = Switch("--allow-faults", "breaks things", {"plant_service": {"allowed": True}})
    return ServiceProgram("plant_emulator", "It.", "so", "a.yaml", "all", made.make, (switch,))


@pytest.mark.parametrize(("named", "recorded"), [("monday", "monday/plant_emulator"), ("", None)])
def test_containers_name_by_the_environment_where_all_record(
    monkeypatch: pytest.MonkeyPatch, named: str, recorded: str | None
) -> None:
    monkeypatch.setenv(RECORDS, named)
    made = Made(lambda log: 0)
    assert service_main(program(made), ["--config-dir", "c"]) == 0
    assert made.options is not None
    assert made.options.record_dir == (None if recorded is None else Path(recorded))
    assert service_main(program(made), ["--config-dir", "c", "--record-dir", "own"]) == 0
    assert made.options.record_dir == Path("own"), "what is said is what counts"


def refusing(error: Exception) -> Body:
    def body(_log: EventLog) -> int:
        raise error

    return body


def test_the_command_line_becomes_options(tmp_path: Path) -> None:
    made = Made(lambda log: 0)
    words = [
        "--set",
        "plant.payload.mass_kg=50",
        "plant.seed=1",
        "--set",
        "scene.n=2",
        "--allow-faults",
    ]
    assert service_main(program(made), [*words, "--config-dir", "c", "--record-dir", str(tmp_path)]) == 0
    overrides = {"plant": {"payload": {"mass_kg": 50}, "seed": 1}, "scene": {"n": 2}}
    switched = overrides | {"plant_service": {"allowed": True}}
    assert made.options == ServiceOptions(Path("c"), switched, tmp_path)
    assert service_main(program(made), []) == 0
    assert made.options == ServiceOptions(Path("configs"), {}, None)


def test_the_status_of_the_service_is_the_status_of_the_process(capsys: pytest.CaptureFixture[str]) -> None:
    def failing(log: EventLog) -> int:
        log.write("stopped", "error", cause="link.renderer_ended")
        return 1

    assert service_main(program(Made(failing)), []) == 1
    assert json.loads(capsys.readouterr().err)["cause"] == "link.renderer_ended"


@pytest.mark.parametrize("error", [ConfigurationError("configuration.x", "taken"), LinkLost("link.x", "y")])
def test_what_is_raised_on_purpose_is_one_line_and_status_2(
    error: ConfigurationError | LinkLost, capsys: pytest.CaptureFixture[str]
) -> None:
    assert service_main(program(Made(refusing(error))), []) == 2
    assert capsys.readouterr().err == f"plant_emulator: {error.cause}: {error}\n"


def test_an_interrupt_leaves_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    made = Made(lambda log: 0)

    def interrupted(options: ServiceOptions, log: EventLog) -> Made:
        raise KeyboardInterrupt

    assert service_main(program(made)._replace(make=interrupted), []) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("bound", [bound_tcp, bound_udp])
def test_a_busy_port_and_an_address_of_others_are_named(
    bound: Callable[[str, int, str], socket.socket],
) -> None:
    with bound("127.0.0.1", 0, "a.b") as holder:
        if bound is bound_tcp:
            holder.listen()
        port = holder.getsockname()[1]
        with pytest.raises(ConfigurationError, match=rf"^a\.b = 127\.0\.0\.1:{port}: ") as busy:
            bound("127.0.0.1", port, "a.b")
    assert busy.value.cause == "configuration.port_busy"
    for host, told in (("192.0.2.1", ""), ("no such host", ""), ("::1", "an address of IPv4")):
        with pytest.raises(ConfigurationError, match=rf"^a\.b = {host}:0: {told}") as foreign:
            bound(host, 0, "a.b")
        assert foreign.value.cause == "configuration.bad_address"
