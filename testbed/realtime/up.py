"""`longreach up`: the three services until somebody ends them."""

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

from testbed.choices import USUAL_TIMING, ClockKind, ControllerKind, Timing
from testbed.realtime.launch import Launch, prepare
from testbed.realtime.supervisor import Supervisor, supervised
from testbed.reporting.console import Bars, out, table
from testbed.reporting.run_directory import run_directory
from testbed.scenarios.scenario import Overrides


def run_up(
    config_dir: Path,
    overrides: Overrides,
    any_ports: bool,
    runs: Path,
    foxglove: int | None = None,
    controller: ControllerKind = ControllerKind.PYTHON,
    timing: Timing = USUAL_TIMING,
) -> None:
    """Run the services until Ctrl-C or SIGTERM ends them.

    Raises ServiceFailed when one ends by itself.
    """
    end_on_sigterm()
    with run_directory(runs) as directory:
        launch = prepare(
            config_dir,
            overrides,
            directory,
            any_ports=any_ports,
            foxglove=foxglove,
            controller=controller,
            timing=timing,
        )
        try:
            with supervised(launch.services, launch.directory, partial(tell, None)) as supervisor:
                show(launch, supervisor)
                supervisor.watch(tell=tell)
        except KeyboardInterrupt:
            out.print("ended")


def tell(at_s: float | None, what: str) -> None:
    """Print one line about a service, with the time of day at which it happened; None: now."""
    when = time.strftime("%H:%M:%S", time.localtime(at_s))
    out.print(f"{when}  {what}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def started(launch: Launch, shown: Bars) -> Iterator[Supervisor]:
    """The services running, with a progress bar for their start, in a block that ends them."""
    with ExitStack() as stack:
        with shown.step("starting three processes") as bar:
            services = supervised(launch.services, launch.directory, partial(bar.update, 0.0))
            supervisor = stack.enter_context(services)
        yield supervisor


def show(launch: Launch, supervisor: Supervisor) -> None:
    """Print which service runs where, whose time all go by, and every address."""
    rows = [
        (name, child.pid, (child.ready or {}).get("scheduling", ""), launch.directory / f"{name}.log")
        for name, child in supervisor.children.items()
    ]
    out.print(table("running", ("service", "process", "scheduling", "log"), rows))
    wall = "the wall's: on a busy machine cycles are late, and the arm stops"
    plant = "the plant's: a busy machine is slow, nothing is late (--clock wall: in real time)"
    out.print(f"clock: {plant if launch.clock is ClockKind.PLANT else wall}", highlight=False)
    show_addresses(launch)
    out.print(f"REST API: {launch.rest_url}/docs   end with Ctrl-C", highlight=False)
    out.print("a service that ends or crashes is started anew alone; the arm stays disabled", highlight=False)


def show_addresses(launch: Launch) -> None:
    """Print where the plant's fault API, the console and the live view are, as far as they are there."""
    face = launch.settings.plant_service.fault_face
    if face.allowed:
        out.print(f"faults: http://{face.host}:{face.port}/docs", highlight=False)
    out.print(f"console: {launch.rest_url}/", highlight=False)
    if launch.foxglove is not None:
        at = f"127.0.0.1:{launch.foxglove}"
        out.print(f"live: ws://{at} (Foxglove WebSocket), http://{at}/metrics", highlight=False)


def end_on_sigterm() -> None:
    """Let SIGTERM end this process as Ctrl-C does, with its services."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
