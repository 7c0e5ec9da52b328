"""Attacks of strangers: each does what it says to a listener, and the verdict names the one that succeeds."""

import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.experiments.robustness.attacks import (
    GROWTH_MB,
    NONE,
    STOP_P99_MS,
    AttackRow,
    AttackSettings,
    attack_table,
    attack_tasks,
    attack_verdict,
)
from laboratory.experiments.robustness.strangers import ATTACKS, Listeners

SECONDS = 0.3
REFUSED = b"HTTP/1.1 413 too large\r\nContent-Length: 0\r\n\r\n"


class Listener:
    """Answers every connection's first bytes with ``answer``, if any, and counts what came."""

    def __init__(self, answer: bytes) -> None:
        self.answer = answer
        self.connections = 0
        self.received = 0
        self.first: Counter[bytes] = Counter()
        self.socket = socket.create_server(("127.0.0.1", 0), backlog=2048)
        self.address = self.socket.getsockname()

    def serve(self) -> None:
        while True:
            try:
                connection, _ = self.socket.accept()
            except OSError:
                return
            self.connections += 1
            threading.Thread(target=self._read, args=(connection,), daemon=True).start()

    def _read(self, connection: socket.socket) -> None:
        with connection:
            connection.settimeout(1.0)
            try:
                first = connection.recv(65_536)
                self.first[first[:16]] += 1
                self.received += len(first)
                if self.answer:
                    connection.sendall(self.answer)
                while self.answer != REFUSED and (more := connection.recv(65_536)):
                    self.received += len(more)
                    if self.answer:
                        connection.sendall(self.answer)
            except OSError:
                return


@contextmanager
def listening(answer: bytes) -> Iterator[Listener]:
    listener = Listener(answer)
    thread = threading.Thread(target=listener.serve, daemon=True)
    thread.start()
    try:
        yield listener
    finally:
        listener.socket.shutdown(socket.SHUT_RDWR)
        listener.socket.close()
        thread.join(2.0)


def until(condition: Callable[[], bool]) -> None:
    """Return when ``condition()`` holds; fail after ten seconds."""
    deadline_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def _counts(attack: str, listener: Listener) -> Counter[str]:
    return ATTACKS[attack](Listeners(*[listener.address] * 5), SECONDS)


@pytest.mark.parametrize(
    "attack",
    ["large-bodies-to-faults", "many-members-to-faults", "large-bodies-to-rest", "chunked-bodies-to-rest"],
)
def test_a_body_that_is_refused_midway_is_counted_by_its_status(attack: str) -> None:
    with listening(REFUSED) as listener:
        counts = _counts(attack, listener)
    assert set(counts) <= {"413", "closed"}
    assert listener.connections == counts.total() > 0
    assert set(listener.first) == {b"POST /faults HTT"} or set(listener.first) == {b"POST /operations"}


@pytest.mark.parametrize(
    ("attack", "count"),
    [("half-requests-to-faults", 500), ("half-requests-to-rest", 500), ("half-frames-to-fieldbus", 200),
     ("noise-to-camera", 300)],
)  # fmt: skip
def test_half_a_request_is_held_on_every_connection(attack: str, count: int) -> None:
    with listening(b"") as listener:
        counts = _counts(attack, listener)
        until(lambda: listener.connections >= count)  # the listener takes them up one by one
        assert listener.connections == count
    assert counts.total() == count


@pytest.mark.realtime  # so many within a fraction of a second
@pytest.mark.parametrize(
    "attack", ["pollers-of-kinds", "pollers-of-state", "pipelined-requests", "requests-ahead"]
)
def test_pollers_count_answers_by_status(attack: str) -> None:
    with listening(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n") as listener:
        counts = _counts(attack, listener)
    assert counts["200"] + counts["answers"] > 10


def test_the_fieldbus_client_that_never_reads_notices_back_pressure() -> None:
    with listening(b"") as silent:  # reads all, answers nothing: no back-pressure
        assert _counts("fieldbus-unread", silent)["no longer read"] == 0
        until(lambda: silent.received >= 6000)
    closed = socket.create_server(("127.0.0.1", 0))  # accepts, and reads nothing
    with closed:
        targets = Listeners(*[closed.getsockname()] * 5)
        assert ATTACKS["fieldbus-unread"](targets, 1.0)["no longer read"] >= 1


@pytest.mark.realtime  # so many within a fraction of a second
def test_datagrams_of_strangers_are_hellos_and_noise() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.setblocking(False)
        counts = ATTACKS["datagrams-of-strangers"](Listeners(*[link.getsockname()] * 5), SECONDS)
        first, second = link.recv(2048), link.recv(2048)
    assert counts["datagrams"] >= 200
    assert {len(first), len(second)} == {72, 68}


def _row(**changes: Any) -> AttackRow:
    sound = AttackRow("followers", "succeeded", 3, 0, [5.0, 6.0, 7.0], 3000, 0, 0, 0, 5.0, {"503": 936}, "")
    return sound._replace(**changes)


def _done(*rows: AttackRow, only: list[str] | None = None) -> Finished[AttackSettings, AttackRow]:
    request = CampaignRequest(config_dir=Path("configs"), out=Path("out"), runs=0, seed=1)
    return Finished(request, AttackSettings(only), [], rows, 0)


def test_the_one_in_peace_is_always_among_the_tasks() -> None:
    done = _done()
    names = [task["attack"] for task in attack_tasks(done.request, AttackSettings(["followers"]))]
    assert names == [NONE, "followers"]
    tasks = attack_tasks(done.request, AttackSettings(windows=2))
    assert [task["attack"] for task in tasks] == [*ATTACKS, *ATTACKS]
    assert len({task["directory"] for task in tasks}) == len(tasks)


def test_nothing_that_happens_in_peace_is_blamed_on_an_attack() -> None:
    rows = (
        _row(attack=NONE, exchange_failures=5, links_lost=1, motion="link.lost"),
        _row(),
        _row(links_lost=1),
    )
    assert all(check.met for check in attack_verdict(_done(*rows)))
    assert attack_table(_done(*rows))[0].row_count == 2


@pytest.mark.parametrize(
    "changes",
    [
        {"motion": "link.link_timeout"},
        {"stops_failed": 1},
        {"stop_ms": [STOP_P99_MS + 1.0] * 3},
        {"exchange_failures": 1},
        {"links_lost": 1},
        {"growth_mb": GROWTH_MB + 1.0},
        {"failure": "link.rest: gone"},
    ],
)
def test_an_attack_that_succeeds_is_named(changes: dict[str, Any]) -> None:
    checks = attack_verdict(_done(_row(attack=NONE), _row(**changes)))
    assert [check.found for check in checks if not check.met] == ["followers"]
