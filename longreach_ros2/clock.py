"""``/clock`` of a machine in simulated time, and the service that lets it stand."""

import asyncio
from typing import Any

from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from longreach_ros2.lockstep import SimulatedMachine


class ClockPublisher:
    """``publish`` sends the simulated time; ``~/pause`` (SetBool) lets it stand or go on.

    Made where the event loop runs that the machine is of.
    """

    def __init__(self, node: Node, machine: SimulatedMachine) -> None:
        self._loop, self._machine = asyncio.get_running_loop(), machine
        self._clock = node.create_publisher(Clock, "/clock", 1)
        node.create_service(SetBool, "~/pause", self._pause)

    def publish(self, time_ns: int) -> None:
        """Send ``time_ns`` as ROS time."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, 10**9)
        self._clock.publish(message)

    def _pause(self, request: Any, response: Any) -> Any:
        self._loop.call_soon_threadsafe(self._machine.pause, request.data)
        response.success = True
        return response
