"""A recording as a ROS 2 bag: what has a standard message there, under the names that its tools look for."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from mcap.records import Message
from rosbags.interfaces import Connection, Qos
from rosbags.interfaces import QosDurability as Durability
from rosbags.interfaces import QosHistory as History
from rosbags.interfaces import QosLiveliness as Liveliness
from rosbags.interfaces import QosReliability as Reliability
from rosbags.interfaces import QosTime as Time
from rosbags.rosbag2 import StoragePlugin, Writer

from foundation.recording.decoding import class_in
from foundation.recording.reading import Damage, walk
from foundation.recording.recovery import contents
from testbed.recordings import ros2_messages as ros
from testbed.recordings.merging import JOINTS

_BAG_VERSION: Final = 8  # of Humble; later distributions read it too
_ALWAYS = Time(2147483647, 4294967295)  # what `ros2 bag record` writes for a limit that is not set
_STATIC = "/tf_static"
_JOINT_STATES = {"/controller/state": "/joint_states", "/plant/truth": "/plant/joint_states"}
_JOINT_STATES["/plant/capture"] = _JOINT_STATES["/plant/truth"]  # takes the place of a regular truth
Sent = Iterator[tuple[str, Any]]
Maker = Callable[[str, Any, int], Sent]


class Ros2Bag(NamedTuple):
    """What became of a recording: messages by topic of the bag, and topics without a standard message."""

    written: dict[str, int]
    left_out: list[str]
    damages: tuple[Damage, ...]


class _Cameras:
    """Pictures with the calibration of their eye beside each, under the same stamp, as ROS wants it."""

    def __init__(self) -> None:
        self._told: dict[str, Any] = {}

    def calibration(self, topic: str, said: Any, log_ns: int) -> Sent:
        """The calibration by itself."""
        name = topic.removesuffix("/calibration")
        self._told[name] = said
        yield f"{name}/camera_info", ros.camera_info(said, said)

    def picture(self, topic: str, said: Any, log_ns: int) -> Sent:
        """The picture and its calibration."""
        name = topic.removesuffix("/image")
        if name in self._told:
            yield f"{name}/camera_info", ros.camera_info(self._told[name], said)
        if said.DESCRIPTOR.name == "CompressedImage":
            yield f"{name}/image_raw/compressed", ros.compressed(said)
        else:
            yield f"{name}/image_raw", ros.image(said)


def to_ros2(source: Path, directory: Path) -> Ros2Bag:
    """Write the recording ``source``, merged or of one part, as a bag in the new ``directory``.

    Raises FileExistsError where that exists, OSError, RecordingUnreadable.
    """
    if directory.exists():
        raise FileExistsError(17, "exists already", str(directory))
    found = contents(source)
    makers = _makers()
    classes = {
        channel: class_in(topic.format)
        for channel, topic in found.topics.items()
        if topic.format.schema in makers
    }
    connections: dict[str, Connection] = {}
    written: Counter[str] = Counter()
    with (
        Writer(directory, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as bag,
        source.open("rb") as stream,
    ):
        for record in walk(stream):
            if not isinstance(record, Message) or record.channel_id not in classes:
                continue
            known = found.topics[record.channel_id]
            said = classes[record.channel_id].FromString(record.data)
            for topic, message in makers[known.format.schema](known.name, said, record.log_time):
                if topic not in connections:
                    connections[topic] = _connected(bag, topic, message)
                data = ros.STORE.serialize_cdr(message, message.__msgtype__)
                bag.write(connections[topic], record.log_time, data)
                written[topic] += 1
    left_out = [topic.name for channel, topic in found.topics.items() if channel not in classes]
    return Ros2Bag(dict(written), left_out, found.damages)


def _connected(bag: Writer, topic: str, message: Any) -> Connection:
    """A topic of the bag. What is said once is offered to those who come later, too."""
    once = topic in (_STATIC, "/scene")
    lasting = Durability.TRANSIENT_LOCAL if once else Durability.VOLATILE
    offered = Qos(
        History.KEEP_LAST,
        10,
        Reliability.RELIABLE,
        lasting,
        _ALWAYS,
        _ALWAYS,
        Liveliness.AUTOMATIC,
        _ALWAYS,
        False,
    )
    return bag.add_connection(topic, message.__msgtype__, typestore=ros.STORE, offered_qos_profiles=[offered])


def _makers() -> dict[str, Maker]:
    """By schema: topics and messages of the bag from a topic, its message and the log time."""
    cameras = _Cameras()

    def as_named(make: Callable[[Any], Any], name: str = "") -> Maker:
        return lambda topic, said, _: iter([(name or topic, make(said))])

    def frames(topic: str, said: Any, log_ns: int) -> Sent:
        yield _STATIC if topic == JOINTS else "/tf", ros.transforms(said)

    def joints(angle: str, rate: str = "") -> Maker:
        def made(topic: str, said: Any, log_ns: int) -> Sent:
            yield _JOINT_STATES[topic], ros.joints(said, log_ns, angle, rate)

        return made

    return {
        "foxglove.FrameTransforms": frames,
        "foxglove.Log": as_named(ros.log, "/rosout"),
        "foxglove.CameraCalibration": cameras.calibration,
        "foxglove.RawImage": cameras.picture,
        "foxglove.CompressedImage": cameras.picture,
        "foxglove.PoseInFrame": as_named(ros.pose),
        "foxglove.PosesInFrame": as_named(ros.path),
        "foxglove.SceneUpdate": as_named(ros.scene),
        "longreach.ControllerState": joints("q_meas_{}_rad"),
        "longreach.PlantTruth": joints("q_{}_rad", "q_rate_{}_rad_s"),
    }
