"""Odometry over a recorded sequence: two directories of pictures in, a TUM trajectory out."""

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from protocol.errors import ConfigurationError, MeasurementFailed
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.odometry.shared_offset import FoundOffset
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose, StereoPair
from vision_pc.shell.cameras.grey_files import read_pair
from vision_pc.shell.cameras.picture_files import EyeFiles, eye_files
from vision_pc.shell.cameras.sequence_calibration import kitti_eyes, recorded_camera

UNREADABLE = "configuration.bad_recording"


class PairRecord(NamedTuple):
    """What became of one pair: its pose in the C0 of map ``segment``, or None and the ``loss``'s cause with
    its figure.
    """

    frame_id: int
    capture_ns: int
    segment: int | None
    pose: OdometryPose | None
    loss: str | None
    detail: str | None


class SequenceResult(NamedTuple):
    """What became of a sequence, pair by pair; ``joints[k]``: map k's C0 in the first's, None: unknown.

    ``offset``: of the right eye's columns, where the way showed it and it was taken out. ``notes``: what was
    chosen of the files, and what left out.
    """

    records: list[PairRecord]
    joints: list[Array | None]
    keyframes: int
    offset: FoundOffset | None = None
    notes: tuple[str, ...] = ()

    @property
    def poses(self) -> list[OdometryPose]:
        """Those in the first map's C0, in order of time: of the first map and of maps joined to it."""
        return self.poses_of(0)

    @property
    def lost(self) -> int:
        """In how many pairs the odometry was lost."""
        return sum(record.pose is None for record in self.records)

    @property
    def losses(self) -> Counter[str]:
        """How often each cause occurred."""
        return Counter(record.loss for record in self.records if record.loss is not None)

    @property
    def apart(self) -> list[int]:
        """Maps with poses that nothing joins to the first one."""
        held = {record.segment for record in self.records}
        return [k for k, joint in enumerate(self.joints) if joint is None and k in held]

    def poses_of(self, k: int) -> list[OdometryPose]:
        """The poses of map ``k``; for the first, of all that are joined to it."""
        found = []
        for record in self.records:
            if record.pose is None or record.segment is None:
                continue
            joint = self.joints[record.segment]
            if record.segment == k:
                found.append(record.pose)
            elif k == 0 and joint is not None:
                found.append(record.pose._replace(X_C0C=joint @ record.pose.X_C0C))
        return found


def read_pairs(found: EyeFiles) -> Iterator[StereoPair | PairRecord]:
    """The pairs of two directories; the record of a lost one for what is no picture, or of another size than
    the first pair. Raises ConfigurationError where no pair can be read.
    """
    shape, error = None, None
    for index, ((one, other), at_ns) in enumerate(zip(found.files, found.times_ns, strict=True)):
        try:
            pair = read_pair(one, other, at_ns, index)
            if pair.left.shape != (shape := shape or pair.left.shape):
                why = f"{one} is of another size than the first picture"
                raise ConfigurationError(UNREADABLE, why)
            yield pair
        except ConfigurationError as bad:
            error = error or bad
            yield PairRecord(index, at_ns, None, None, UNREADABLE, str(bad))
    if shape is None and error is not None:
        raise error


class Recorded(NamedTuple):
    """Two directories of pictures, their calibration, and pairs a second where no times are."""

    left: Path
    right: Path
    calibration: Path
    rate_hz: float = 10.0

    def files(self) -> EyeFiles:
        """The pairs of pictures, their times, and what was left out. Raises ConfigurationError."""
        return eye_files(self.left, self.right, self.rate_hz)


def follow(
    recorded: Recorded, config: VisionConfig, report: Callable[[PairRecord], None] = lambda record: None
) -> SequenceResult:
    """The odometry of a whole sequence, rectified first where its calibration is of a camera as it comes;
    ``report`` hears of every pair. Raises MeasurementFailed if all were lost.
    """
    files = recorded.files()
    eyes = kitti_eyes(recorded.left, recorded.right)
    first = next(pair for pair in read_pairs(files) if isinstance(pair, StereoPair))
    known = recorded_camera(recorded.calibration, first, eyes)
    result = follow_pairs(
        lambda: (
            known.rectified(pair) if isinstance(pair, StereoPair) else pair for pair in read_pairs(files)
        ),
        lambda pair: SegmentedOdometry(known.camera, config.odometry_of_recordings),
        report,
    )
    if result.lost == len(result.records):
        last = result.records[-1]
        figure = "" if last.detail is None else f" ({last.detail})"
        raise MeasurementFailed(
            "measurement.odometry_lost",
            f"{recorded.left}: all {len(result.records)} pairs lost, last cause {last.loss}{figure}",
        )
    unread = {record.detail or "": None for record in result.records if record.loss == UNREADABLE}
    return result._replace(notes=(*files.notes, *known.notes, *unread))


def follow_pairs(
    pairs: Callable[[], Iterable[StereoPair | PairRecord]],
    begin: Callable[[StereoPair], SegmentedOdometry],
    report: Callable[[PairRecord], None] = lambda record: None,
) -> SequenceResult:
    """What odometry, begun with the first of ``pairs``, finds in all of them. Where disparities turn out to
    be off, pairs are followed anew from the first on. A record stands for a pair that could not be read.
    """
    result, offset = _one_pass(pairs(), begin, None, report)
    return result if offset is None else _one_pass(pairs(), begin, offset, report)[0]


def _one_pass(
    pairs: Iterable[StereoPair | PairRecord],
    begin: Callable[[StereoPair], SegmentedOdometry],
    known: FoundOffset | None,
    report: Callable[[PairRecord], None],
) -> tuple[SequenceResult, FoundOffset | None]:
    """What is found with the offset ``known``, and the offset that was learnt."""
    records: list[PairRecord] = []
    odometry: SegmentedOdometry | None = None
    for pair in pairs:
        if isinstance(pair, PairRecord):
            records.append(pair)
            report(pair)
            continue
        if odometry is None:
            odometry = begin(pair)
            if known is not None:
                odometry.correct(known)
        placed = odometry.process(pair)
        segment, pose = (None, None) if placed is None else placed
        loss = odometry.last_loss if pose is None else None
        detail = odometry.last_detail if pose is None else None
        records.append(PairRecord(pair.frame_id, pair.capture_ns, segment, pose, loss, detail))
        report(records[-1])
        if odometry.offset.is_settled and odometry.offset_found is not None:
            break
    if odometry is None:
        return SequenceResult([], [], 0), None
    return SequenceResult(records, odometry.joints, odometry.keyframes, known), odometry.offset_found


def write_tum(path: Path, poses: list[OdometryPose]) -> None:
    """Write the trajectory to ``path``: seconds, x y z in metres, quaternion x y z w, one pose a line."""
    lines = []
    for pose in poses:
        (x, y, z), (qw, qx, qy, qz) = se3.to_pose(pose.X_C0C)
        numbers = " ".join(f"{value:.9f}" for value in (x, y, z, qx, qy, qz, qw))
        lines.append(f"{pose.capture_ns / 1e9:.9f} {numbers}\n")
    path.write_text("".join(lines), encoding="ascii")


def write_side_file(path: Path, result: SequenceResult) -> None:
    """Write a line a pair to ``path`` (CSV): time, map, loss, health, pose in its map's C0, and covariance.

    ``joined``: the pose is in the trajectory, because its map is the first or joined to it. ``c_ij`` are the
    upper half of the covariance of [δp; δθ] in m and rad, axes of C0.
    """
    upper = [(i, j) for i in range(6) for j in range(i, 6)]
    names = "pair,time_s,map,joined,loss,detail,inliers,coverage,residual_px,x_m,y_m,z_m,qw,qx,qy,qz"
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream)
        table.writerow([*names.split(","), *(f"c_{i}{j}" for i, j in upper)])
        for record in result.records:
            line: list[object] = [record.frame_id, f"{record.capture_ns / 1e9:.9f}"]
            if record.pose is None or record.segment is None:
                line += ["", "", record.loss, record.detail or ""]
            else:
                pose, joined = record.pose, result.joints[record.segment] is not None
                position, turn = se3.to_pose(pose.X_C0C)
                line += [record.segment, int(joined), "", "", pose.inliers, f"{pose.coverage:.3f}"]
                line += [f"{pose.residual_px:.4f}", *(f"{value:.9f}" for value in (*position, *turn))]
                line += [f"{pose.covariance[i, j]:.6e}" for i, j in upper]
            table.writerow(line)
