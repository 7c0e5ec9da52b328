"""The nodes as processes: an event loop for the link or the live face, and ROS's executor in a thread."""

import asyncio
import threading
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
import uvloop
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from foundation.event_log import EventLog
from foundation.service_main import on_termination, say_ready
from longreach_ros2.camera import show
from longreach_ros2.clock import ClockPublisher
from longreach_ros2.drive import ArmDrive
from longreach_ros2.drive_node import DriveNode
from longreach_ros2.live_client import live_messages
from longreach_ros2.lockstep import OFFSET_NS, SimulatedMachine
from longreach_ros2.references import RosTime
from longreach_ros2.watch_node import TOPICS, WatchNode
from nominal_arm.description import NominalArm
from nominal_arm.dimensions import joint_ranges
from protocol.errors import ConfigurationError
from vision_pc.application.link_arm import LinkArm
from vision_pc.config.vision import VisionConfig
from vision_pc.shell.camera_eyes import ProcessClock
from vision_pc.shell.cameras import open_camera
from vision_pc.shell.link.udp_endpoint import UdpEndpoint

_THREADS = 6  # four services, the action, and topics beside them
_STATE_PERIOD_MS = 10
_STOP_S = 2.0


async def drive(arm: NominalArm, config: VisionConfig, log: EventLog, *, tf: bool, with_camera: bool) -> None:
    """Drive the arm until asked to end; ``with_camera``: show its pictures too.

    Raises LinkLost for an address that is none, ConfigurationError.
    """
    camera = open_camera(config.camera) if with_camera else None
    settings = config.link.model_copy(update={"state_period_ms": _STATE_PERIOD_MS})
    clock, ros_time = ProcessClock(), RosTime()
    endpoint = UdpEndpoint(settings, settings.expected_arm(arm), log, clock)
    link = endpoint.link
    link.ranges = joint_ranges(arm)
    driven = ArmDrive(link, LinkArm(link, config.motion), arm, clock, ros_time)
    await endpoint.start()
    node = DriveNode(asyncio.get_running_loop(), driven, arm.name, tf)
    with spinning(node):
        say_ready("longreach_ros2", controller={"host": settings.host, "port": settings.port})
        if camera is None:
            await until_termination(None)
        else:
            await camera.start()
            await until_termination(show(camera, config, node, ros_time))
            await camera.close()
        await _end_goals()
        await endpoint.close()
    log.write("stopped")


async def simulate(machine: SimulatedMachine, pace: float, log: EventLog, *, tf: bool) -> None:
    """Drive ``machine``, which is in this process, and publish its /clock, until asked to end."""
    arm, ros_time = machine.settings.arm, RosTime(OFFSET_NS)
    driven = ArmDrive(
        machine.link, LinkArm(machine.link, machine.settings.vision.motion), arm, machine, ros_time
    )
    node = DriveNode(asyncio.get_running_loop(), driven, arm.name, tf)
    clock = ClockPublisher(node, machine)
    with spinning(node, has_clock=True):
        say_ready("longreach_ros2", lockstep={"pace": pace})
        await until_termination(machine.run(pace, clock.publish))
        await _end_goals()
    log.write("stopped")


async def _end_goals() -> None:
    """Stop what is being followed, while the link is there; else the executor waits for it for ever."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    if others:
        await asyncio.wait(others, timeout=_STOP_S)


async def watch(url: str, log: EventLog) -> None:
    """Publish what the live face at ``url`` shows, until asked to end. Raises as ``live_messages``."""
    node = WatchNode(RosTime())

    async def shown() -> None:
        async for message in live_messages(url, TOPICS):
            node.show(message)

    with spinning(node):
        say_ready("longreach_ros2", watch=url)
        await until_termination(shown())
    log.write("stopped")


async def until_termination(beside: Coroutine[Any, Any, None] | None) -> None:
    """Return on SIGTERM or SIGINT, or raise what ``beside`` raises before."""
    end = asyncio.Event()
    on_termination(end.set)
    waiting = asyncio.ensure_future(end.wait())
    tasks = {waiting} if beside is None else {waiting, asyncio.ensure_future(beside)}
    done, left = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in left:
        task.cancel()
    for task in done:
        task.result()


@contextmanager
def spinning(node: Node, has_clock: bool = False) -> Iterator[None]:
    """A block in which the node's callbacks are served.

    Raises ConfigurationError for ``use_sim_time`` where the node itself does not publish /clock.
    """
    if node.get_parameter("use_sim_time").value and not has_clock:
        words = "use_sim_time: the link's times are the machine's (simulated time: --lockstep)"
        raise ConfigurationError("configuration.no_clock", words)
    executor = MultiThreadedExecutor(_THREADS)
    executor.add_node(node)
    thread = threading.Thread(target=_spin, args=(executor,), name="ros", daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown(timeout_sec=1.0)
        thread.join(1.0)


def _spin(executor: MultiThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        return


def run(work: Coroutine[Any, Any, None], for_ros: list[str]) -> None:
    """Run ``work`` with ROS there, which is given the arguments ``for_ros``."""
    rclpy.init(args=for_ros, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(work)
    finally:
        rclpy.try_shutdown()
