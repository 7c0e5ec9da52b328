"""Recorded messages as the standard messages of ROS 2 that say the same.

The definitions are those of Humble, which later distributions share.
"""

from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from nominal_arm.description import JOINT_NAMES

STORE = get_typestore(Stores.ROS2_HUMBLE)
_NS = 1_000_000_000


def _ros(name: str, /, **fields: Any) -> Any:
    """A message of ROS, such as ``sensor_msgs/Image``."""
    package, _, kind = name.partition("/")
    return STORE.types[f"{package}/msg/{kind}"](**fields)


def _time(time_ns: int) -> Any:
    return _ros("builtin_interfaces/Time", sec=time_ns // _NS, nanosec=time_ns % _NS)


def _stamp(said: Any) -> Any:
    return _time(said.timestamp.seconds * _NS + said.timestamp.nanos)


def _header(said: Any) -> Any:
    return _ros("std_msgs/Header", stamp=_stamp(said), frame_id=said.frame_id)


def _point(said: Any) -> Any:
    return _ros("geometry_msgs/Point", x=said.x, y=said.y, z=said.z)


def _vector(x: float, y: float, z: float) -> Any:
    return _ros("geometry_msgs/Vector3", x=x, y=y, z=z)


def _turn(said: Any) -> Any:
    return _ros("geometry_msgs/Quaternion", x=said.x, y=said.y, z=said.z, w=said.w)


def _pose(said: Any) -> Any:
    turn = _turn(said.orientation)
    return _ros("geometry_msgs/Pose", position=_point(said.position), orientation=turn)


def transforms(said: Any) -> Any:
    """tf2_msgs/TFMessage of foxglove.FrameTransforms."""
    made = []
    for each in said.transforms:
        p = each.translation
        turned = _ros(
            "geometry_msgs/Transform", translation=_vector(p.x, p.y, p.z), rotation=_turn(each.rotation)
        )
        header = _ros("std_msgs/Header", stamp=_stamp(each), frame_id=each.parent_frame_id)
        stamped = {"header": header, "child_frame_id": each.child_frame_id, "transform": turned}
        made.append(_ros("geometry_msgs/TransformStamped", **stamped))
    return _ros("tf2_msgs/TFMessage", transforms=made)


def image(said: Any) -> Any:
    """sensor_msgs/Image of foxglove.RawImage."""
    return _ros(
        "sensor_msgs/Image",
        header=_header(said),
        height=said.height,
        width=said.width,
        encoding=said.encoding,
        is_bigendian=0,
        step=said.step,
        data=np.frombuffer(said.data, dtype=np.uint8),
    )


def compressed(said: Any) -> Any:
    """sensor_msgs/CompressedImage of foxglove.CompressedImage."""
    data = np.frombuffer(said.data, dtype=np.uint8)
    return _ros("sensor_msgs/CompressedImage", header=_header(said), format=said.format, data=data)


def camera_info(said: Any, beside: Any) -> Any:
    """sensor_msgs/CameraInfo of foxglove.CameraCalibration, under the stamp and frame of ``beside``."""
    nowhere = _ros(
        "sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return _ros(
        "sensor_msgs/CameraInfo",
        header=_header(beside),
        height=said.height,
        width=said.width,
        distortion_model=said.distortion_model,
        **{name.lower(): np.array(getattr(said, name), dtype=np.float64) for name in "DKRP"},
        binning_x=0,
        binning_y=0,
        roi=nowhere,
    )


def pose(said: Any) -> Any:
    """geometry_msgs/PoseStamped of foxglove.PoseInFrame."""
    return _ros("geometry_msgs/PoseStamped", header=_header(said), pose=_pose(said.pose))


def path(said: Any) -> Any:
    """nav_msgs/Path of foxglove.PosesInFrame."""
    stamped = [
        _ros("geometry_msgs/PoseStamped", header=_header(said), pose=_pose(pose)) for pose in said.poses
    ]
    return _ros("nav_msgs/Path", header=_header(said), poses=stamped)


def log(said: Any) -> Any:
    """rcl_interfaces/Log of foxglove.Log."""
    levels = {0: 10, 1: 10, 2: 20, 3: 30, 4: 40, 5: 50}  # foxglove.Log.Level: rcl_interfaces/Log
    place = {"file": said.file, "function": "", "line": said.line}
    return _ros(
        "rcl_interfaces/Log",
        stamp=_stamp(said),
        level=levels[said.level],
        name=said.name,
        msg=said.message,
        **place,
    )


def joints(said: Any, log_ns: int, angle: str, rate: str) -> Any:
    """sensor_msgs/JointState under the joint names of `longreach export urdf`."""
    empty = np.zeros(0)
    angles, rates = (
        np.array([getattr(said, name.format(joint)) for joint in JOINT_NAMES]) if name else empty
        for name in (angle, rate)
    )
    header = _ros("std_msgs/Header", stamp=_time(log_ns), frame_id="")
    fields = {"position": angles, "velocity": rates, "effort": empty}
    return _ros("sensor_msgs/JointState", header=header, name=list(JOINT_NAMES), **fields)


def scene(said: Any) -> Any:
    """visualization_msgs/MarkerArray: cubes, cylinders and texts of foxglove.SceneUpdate."""
    kinds = (("cubes", "CUBE"), ("cylinders", "CYLINDER"), ("texts", "TEXT_VIEW_FACING"))
    markers = []
    for entity in said.entities:
        shapes = [(kind, shape) for name, kind in kinds for shape in getattr(entity, name)]
        markers += [_marker(entity, number, kind, shape) for number, (kind, shape) in enumerate(shapes)]
    return _ros("visualization_msgs/MarkerArray", markers=markers)


def _marker(entity: Any, number: int, kind: str, shape: Any) -> Any:
    text = shape.text if kind == "TEXT_VIEW_FACING" else ""
    size = _vector(0.0, 0.0, shape.font_size) if text else _vector(shape.size.x, shape.size.y, shape.size.z)
    colour = {name: getattr(shape.color, name) for name in "rgba"}
    nothing = np.zeros(0, dtype=np.uint8)
    return _ros(
        "visualization_msgs/Marker",
        header=_header(entity),
        ns=entity.id,
        id=number,
        type=getattr(STORE.types["visualization_msgs/msg/Marker"], kind),
        action=0,
        pose=_pose(shape.pose),
        scale=size,
        color=_ros("std_msgs/ColorRGBA", **colour),
        lifetime=_ros("builtin_interfaces/Duration", sec=0, nanosec=0),
        frame_locked=entity.frame_locked,
        points=[],
        colors=[],
        texture_resource="",
        texture=_ros("sensor_msgs/CompressedImage", header=_header(entity), format="", data=nothing),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=_ros("visualization_msgs/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )
