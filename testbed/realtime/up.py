"""`longreach up`: the three services until somebody ends them."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType

from testbed.choices import ControllerKind
from testbed.realtime.launch import CONTROLLER, PLANT, Launch, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.reporting.console import Bars, out, table
from testbed.reporting.run_directory import run_directory
from testbed.reporting.run_record import note_settings
from testbed.scenarios.scenario import Overrides


def run_up(
    config_dir: Path,
    overrides: Overrides,
    any_ports: bool,
    runs: Path,
    foxglove: int | None = None,
    controller: ControllerKind = ControllerKind.PYTHON,
) -> None:
    """Run the services until Ctrl-C or SIGTERM ends them.

    Raises ServiceFailed when one ends by itself.
    """
    end_on_sigterm()
    with run_directory(runs) as directory:
        launch = prepare(
            config_dir, overrides, directory, any_ports=any_ports, foxglove=foxglove, controller=controller
        )
        note_settings(directory, launch.settings)
        try:
            with supervised(launch.services, launch.directory) as supervisor:
                show(launch, supervisor)
                supervisor.watch(tell=tell)
        except KeyboardInterrupt:
            out.print("ended")


def tell(at_s: float, trouble: str) -> None:
    """Print one line about a service, with the time of day at which it happened."""
    when = f"{datetime.fromtimestamp(at_s):%H:%M:%S}"
    out.print(f"{when}  {trouble}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def started(launch: Launch, shown: Bars) -> Iterator[Supervisor]:
    """The services running, with a progress bar for their start, in a block that ends them."""
    with ExitStack() as stack:
        with shown.step("starting three processes") as bar:
            supervisor = stack.enter_context(supervised(launch.services, launch.directory, bar.update))
        yield supervisor


def show(launch: Launch, supervisor: Supervisor) -> None:
    """Print which service runs where."""
    rows = [
        (name, child.pid, (child.ready or {}).get("scheduling", ""), launch.directory / f"{name}.log")
        for name, child in supervisor.children.items()
    ]
    out.print(table("running", ("service", "process", "scheduling", "log"), rows))
    show_real_time(supervisor)
    show_fault_api(launch)
    show_console(launch)
    show_live(launch)
    out.print(f"REST API: {launch.rest_url}/docs   end with Ctrl-C", highlight=False)
    out.print("a service that ends or crashes is started anew alone; the arm stays disabled", highlight=False)


def show_real_time(supervisor: Supervisor) -> None:
    """Say so if plant or controller has no real-time class."""
    scheduling = {name: (child.ready or {}).get("scheduling") for name, child in supervisor.children.items()}
    lacking = [name for name in (PLANT, CONTROLLER) if scheduling.get(name) != "fifo"]
    if lacking:
        said = f"no real-time class for {' and '.join(lacking)}: expect late cycles while other work runs"
        out.print(said, highlight=False)


def show_console(launch: Launch) -> None:
    """Print the address of the operator's console; where it wants a token, who opens it is asked for one."""
    out.print(f"console: {launch.rest_url}/", highlight=False)


def show_live(launch: Launch) -> None:
    """Print where viewers connect, and where Prometheus reads, if there is such a face."""
    if launch.foxglove is not None:
        at = f"127.0.0.1:{launch.foxglove}"
        out.print(f"live: ws://{at} (Foxglove WebSocket), http://{at}/metrics", highlight=False)


def show_fault_api(launch: Launch) -> None:
    """Print the address of the plant's fault API, if it is allowed."""
    face = launch.settings.plant_service.fault_face
    if face.allowed:
        out.print(f"faults: http://{face.host}:{face.port}/docs", highlight=False)


def end_on_sigterm() -> None:
    """Let SIGTERM end this process as Ctrl-C does, with its services."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
