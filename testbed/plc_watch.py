"""A client of ADS that reads variables at a pace, shows them and writes them down.

It is Beckhoff's own client library (pyads, not a dependency), so what it can read here it can read of a
TwinCAT. Rows are sum reads: all values of a row are of one moment between two cycles.
"""

import csv
import math
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Self, TextIO

from rich.live import Live
from rich.table import Table

from protocol.errors import ConfigurationError, LinkLost, RequestRefused
from testbed.reporting.console import err, out, table

_ANSWER_MS = 2000
_PLC_PORT = 851  # of the first runtime
_UNKNOWN_NAME, _NO_SUCH_PORT = 0x710, 6
Row = dict[str, Any]


def plc_address(text: str) -> tuple[str, str, int]:
    """Host, AMS net id and AMS port of ``HOST[/NETID][:PORT]``. Raises RequestRefused."""
    found = re.fullmatch(r"([^/:]+)(?:/([\d.]+))?(?::(\d{1,5}))?", text)
    if found is None:
        why = f"--host {text} is not HOST[/NETID][:PORT], such as 192.168.0.1/192.168.0.1.1.1:851"
        raise RequestRefused("refused.plc.address", why)
    return found[1], found[2] or f"{found[1]}.1.1", int(found[3] or _PLC_PORT)


class WatchedPlc:
    """A connection to a PLC's runtime. ``net_id``: AMS net id, such as 192.168.0.1.1.1.

    Raises ConfigurationError without pyads or for a net id that is none, LinkLost where nobody answers.
    """

    def __init__(self, host: str, net_id: str, port: int) -> None:
        try:
            self._ads: Any = import_module("pyads")
        except ImportError as error:
            why = "longreach plc needs pyads, Beckhoff's client library: pip install pyads"
            raise ConfigurationError("extension.not_installed", why) from error
        self._where = f"{host}, AMS {net_id}:{port}"
        try:
            self._ads.add_route(net_id, host)
            self._client = self._ads.Connection(net_id, port, host)
        except (ValueError, TypeError) as error:
            why = f"AMS net id {net_id} is not six numbers from 0 to 255 with dots: {error}"
            raise ConfigurationError("configuration.bad_value", why) from error
        except self._ads.ADSError as error:
            raise LinkLost("link.plc", f"{self._where}: nobody answers at TCP port 48898") from error

    def __enter__(self) -> Self:
        self._client.open()
        self._client.set_timeout(_ANSWER_MS)
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()

    def symbols(self) -> list[tuple[str, str]]:
        """Every variable of the PLC with its type."""
        with self._asked():
            return [(each.name, each.symbol_type) for each in self._client.get_all_symbols()]

    def types(self, names: list[str]) -> dict[str, str]:
        """The type of each variable.

        Raises RequestRefused for a name that the PLC does not have, and for one that is no single value.
        """
        found = {}
        for name in names:
            with self._asked(name):
                symbol = self._client.get_symbol(name)
            if symbol.plc_type is None or str(symbol.symbol_type).upper().startswith("ARRAY"):
                why = f"{name} is a {symbol.symbol_type}: name its parts (longreach plc watch --find {name})"
                raise RequestRefused("refused.plc.not_scalar", why)
            found[name] = str(symbol.symbol_type)
        return found

    def read(self, names: list[str]) -> Row:
        """Their values of one moment."""
        with self._asked():
            row = self._client.read_list_by_name(names)
        return {name: row[name] for name in names}

    @contextmanager
    def _asked(self, name: str = "") -> Iterator[None]:
        try:
            yield
        except self._ads.ADSError as error:
            if error.err_code == _UNKNOWN_NAME:
                why = f"{name or 'a name'}: {self._where} has no such variable; without names all are listed"
                raise RequestRefused("refused.plc.unknown_name", why) from error
            if error.err_code == _NO_SUCH_PORT:
                raise LinkLost("link.plc", f"{self._where}: no runtime on this AMS port") from error
            why = f"{self._where}: {error}; does it listen, and has a TwinCAT a route to this machine?"
            raise LinkLost("link.plc", why) from error


def list_symbols(plc: WatchedPlc, find: str) -> None:
    """Print the variables whose names hold ``find``, in any letters."""
    every = plc.symbols()
    rows = [(name, kind) for name, kind in every if find.upper() in name.upper()]
    out.print(table(f"{len(rows)} of {len(every)} variables", ("name", "type"), rows))


class WatchedValues(NamedTuple):
    """Of each variable what it was; rows read, rows left out, and why the PLC went silent, if it did."""

    variables: dict[str, dict[str, Any]]
    rows: int
    late: int
    silent: str


class _Seen:
    """What a variable was: first, last, least, most, and how often it changed."""

    def __init__(self, first: Any) -> None:
        self.first = self.last = first
        self.least, self.most, self.changes = math.inf, -math.inf, 0

    def add(self, value: Any) -> None:
        self.changes += value != self.last
        self.last = value
        if not isinstance(value, str):
            self.least, self.most = min(self.least, value), max(self.most, value)


def watch_values(
    plc: WatchedPlc, names: list[str], every_s: float, seconds: float | None, path: Path | None
) -> WatchedValues:
    """Read ``names`` every ``every_s`` until ``seconds`` or Ctrl-C, show them, and write them to ``path``.

    Where the PLC goes silent before, what it had said is written all the same. Rows that come late are
    counted, not made up.
    """
    kinds = plc.types(names)
    seen = {name: _Seen(value) for name, value in plc.read(names).items()}
    rows, late, silent = 0, 0, ""
    with _written(path, names) as writer, Live(console=out, refresh_per_second=5, transient=True) as live:
        began_s = due_s = time.monotonic()
        try:
            while seconds is None or due_s - began_s <= seconds:
                time.sleep(max(0.0, due_s - time.monotonic()))
                row = plc.read(names)
                at_s = time.monotonic()
                rows += 1
                writer.writerow([f"{at_s - began_s:.6f}", *row.values()])
                for name, value in row.items():
                    seen[name].add(value)
                live.update(_shown(kinds, seen))
                due_s += every_s
                if at_s > due_s:
                    passed = math.ceil((at_s - due_s) / every_s)
                    late, due_s = late + passed, due_s + passed * every_s
        except KeyboardInterrupt:
            pass  # ends it; the rows stay
        except LinkLost as error:
            silent = f"{error.cause}: {error}"
    out.print(_shown(kinds, seen))
    out.print(
        f"{rows} rows in {time.monotonic() - began_s:.1f} s, {late} left out because an answer came late"
    )
    if path is not None:
        out.print(f"{path}: {rows} rows of {len(names)} variables", highlight=False, soft_wrap=True)
    if silent:
        err.print(f"longreach: {silent}", style="bold red", highlight=False, soft_wrap=True, markup=False)
    shown = {name: vars(one) | {"type": kinds[name]} for name, one in seen.items()}
    return WatchedValues(shown, rows, late, silent)


@contextmanager
def _written(path: Path | None, names: list[str]) -> Iterator[Any]:
    file: TextIO | None = None
    if path is not None:
        file = path.open("w", newline="", encoding="utf-8")
    try:
        writer = csv.writer(file or _Nowhere())
        writer.writerow(["time_s", *names])
        yield writer
    finally:
        if file is not None:
            file.close()


class _Nowhere:
    """A file that keeps nothing."""

    def write(self, text: str) -> int:
        """Its length."""
        return len(text)


def _shown(kinds: dict[str, str], seen: dict[str, _Seen]) -> Table:
    rows = []
    for name, one in seen.items():
        bounds = ("", "") if one.least > one.most else (f"{one.least:g}", f"{one.most:g}")
        rows.append((name, kinds[name], str(one.first), str(one.last), *bounds, str(max(one.changes, 0))))
    return table("variables", ("name", "type", "first", "last", "least", "most", "changes"), rows)
