"""What viewers draw of the vision PC's recording, in well-known schemas: pictures, outlines, frames."""

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration as CalibrationMessage
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from foundation.recording.messages import PosedFrame, put_pose, put_time, transforms
from protocol.pose import Pose
from vision_pc.core import se3
from vision_pc.core.types import CameraCalibration, FrameObservation, OdometryPose, StereoPair

CAMERA_FRAMES = ("camera_left_optical", "camera_right_optical")
SEEN_TOOL, SEEN_OBJECT = "seen/tool_marker", "seen/object"
TRACK_FRAME, BASE_FRAME = "odometry", "nominal/base"
_GREEN = (0.3, 0.85, 0.3, 1.0)
_EYES = ("left", "right")
_LINE_PX = 2.0


def raw(pair: StereoPair, eye: int) -> bytes:
    """foxglove.RawImage of one eye, every pixel."""
    picture = getattr(pair, _EYES[eye])
    height, width = picture.shape
    message = RawImage(
        frame_id=CAMERA_FRAMES[eye], width=width, height=height, encoding="mono8", step=width,
        data=picture.tobytes(),
    )  # fmt: skip
    put_time(message.timestamp, pair.capture_ns)
    return bytes(message.SerializeToString())


def jpeg(quality: int) -> Callable[[StereoPair, int], bytes]:
    """What makes foxglove.CompressedImage of one eye."""

    def encode(pair: StereoPair, eye: int) -> bytes:
        _, data = cv2.imencode(".jpg", getattr(pair, _EYES[eye]), [cv2.IMWRITE_JPEG_QUALITY, quality])
        message = CompressedImage(frame_id=CAMERA_FRAMES[eye], format="jpeg", data=data.tobytes())
        put_time(message.timestamp, pair.capture_ns)
        return bytes(message.SerializeToString())

    return encode


def calibrations(camera: CameraCalibration) -> tuple[bytes, bytes]:
    """foxglove.CameraCalibration of both eyes, as the vision PC believes them to be."""
    left, right = (_calibration(camera, eye) for eye in range(2))
    return left, right


def _calibration(camera: CameraCalibration, eye: int) -> bytes:
    model = (camera.left, camera.right)[eye]
    X_EC = se3.inverse(model.X_CE)
    message = CalibrationMessage(
        frame_id=CAMERA_FRAMES[eye],
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        D=model.distortion.tolist(),
        K=model.K.ravel().tolist(),
        R=X_EC[:3, :3].T.ravel().tolist(),
        P=(model.K @ np.column_stack((np.eye(3), X_EC[:3, 3]))).ravel().tolist(),
    )
    return bytes(message.SerializeToString())


def seen_frames(seen: FrameObservation) -> bytes:
    """foxglove.FrameTransforms of tool marker and object in the left eye, as far as they were seen."""
    poses = ((SEEN_TOOL, seen.X_CM), (SEEN_OBJECT, seen.X_CO))
    frames = [PosedFrame(CAMERA_FRAMES[0], name, X) for name, X in poses if X is not None]
    return transforms(frames, seen.capture_ns) if frames else b""


def annotations(seen: FrameObservation) -> bytes:
    """foxglove.ImageAnnotations: each marker's outline in the left picture, and its number."""
    message = ImageAnnotations()
    put_time(message.timestamp, seen.capture_ns)
    for marker in seen.markers:
        outline = message.points.add(type=PointsAnnotation.Type.LINE_LOOP, thickness=_LINE_PX)
        put_time(outline.timestamp, seen.capture_ns)
        _colour(outline.outline_color)
        for x, y in marker.corners_left.tolist():
            outline.points.add(x=x, y=y)
        text = message.texts.add(text=str(marker.marker_id), font_size=16.0)
        put_time(text.timestamp, seen.capture_ns)
        text.position.x, text.position.y = marker.corners_left.max(axis=0).tolist()
        _colour(text.text_color)
    return bytes(message.SerializeToString())


def track_pose(pose: OdometryPose) -> bytes:
    """foxglove.PoseInFrame of the camera in the first camera frame of its odometry."""
    message = PoseInFrame(frame_id=TRACK_FRAME)
    put_time(message.timestamp, pose.capture_ns)
    put_pose(message.pose, pose.X_C0C)
    return bytes(message.SerializeToString())


def path(time_ns: int, poses: Sequence[Pose]) -> bytes:
    """foxglove.PosesInFrame of references of the tool in the base."""
    message = PosesInFrame(frame_id=BASE_FRAME)
    put_time(message.timestamp, time_ns)
    for pose in poses:
        made = message.poses.add()
        made.position.x, made.position.y, made.position.z = pose.p_m
        at = made.orientation
        at.w, at.x, at.y, at.z = pose.q_wxyz
    return bytes(message.SerializeToString())


def _colour(made: Any) -> None:
    made.r, made.g, made.b, made.a = _GREEN
