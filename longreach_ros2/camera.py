"""The pictures of both eyes, as they come, with what the vision PC believes of the lens."""

import asyncio
from functools import partial
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration as CalibrationMessage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from longreach_ros2.references import RosTime
from longreach_ros2.ros_messages import PICTURES, Stamp, camera_info, image
from protocol.errors import LinkLost
from vision_pc.config.vision import VisionConfig
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.shell.cameras import CameraSource
from vision_pc.shell.recording.vision_pictures import calibrations, raw

EYES = ("left", "right")
_RETRY_S = 1.0


class PicturePublisher:
    """``camera/left/image_raw`` and ``camera_info``, and the right eye's; nothing is made for nobody."""

    def __init__(self, node: Node, compressed: bool = False) -> None:
        kind, name = (CompressedImage, "image_raw/compressed") if compressed else (Image, "image_raw")
        made = partial(node.create_publisher, qos_profile=PICTURES)
        self._pictures = {eye: made(kind, f"camera/{eye}/{name}") for eye in EYES}
        self._infos = {eye: made(CameraInfo, f"camera/{eye}/camera_info") for eye in EYES}
        self.lenses: dict[str, Any] = {}

    def has_subscribers(self, eye: str) -> bool:
        """Whether anybody subscribes to this eye."""
        return bool(self._pictures[eye].get_subscription_count() or self._infos[eye].get_subscription_count())

    def publish(self, eye: str, picture: Any, stamp: Stamp) -> None:
        """Publish a picture as ``ros_messages.image`` takes it, and the eye's lens, if it is known."""
        self._pictures[eye].publish(image(picture, stamp))
        if eye in self.lenses:
            self._infos[eye].publish(camera_info(self.lenses[eye], stamp))


async def show(camera: CameraSource, config: VisionConfig, node: Node, ros_time: RosTime) -> None:
    """Publish every picture of ``camera``, until cancelled; a camera that is away is waited for."""
    publisher = PicturePublisher(node)
    lenses = map(CalibrationMessage.FromString, calibrations(calibration(config.camera)))
    publisher.lenses = dict(zip(EYES, lenses, strict=True))
    capture_ns = 0
    while True:
        try:
            pair = await camera.frame_after(capture_ns)
        except LinkLost as error:
            node.get_logger().warning(f"{error.cause}: {error}", throttle_duration_sec=10.0)
            await asyncio.sleep(_RETRY_S)
            continue
        capture_ns = pair.capture_ns
        for number, eye in enumerate(EYES):
            if publisher.has_subscribers(eye):
                publisher.publish(eye, RawImage.FromString(raw(pair, number)), ros_time.of(capture_ns))
