"""What `longreach hand-eye` does with files: solve, compare, intrinsics."""

from pathlib import Path

from foundation.foreign_text import read_each
from foundation.numbers_as_written import written_number
from protocol.errors import MeasurementFailed, RequestRefused
from testbed.camera.checking import question
from testbed.cli.boards import described_board
from testbed.cli.options import PicturedBoard, PoseLines, SampleSource
from testbed.hand_eye import picture_samples, presentation, trajectories
from testbed.hand_eye.importer import ImportOptions, load
from testbed.hand_eye.picture_samples import detect
from testbed.hand_eye.pose_text import read_robot_poses
from testbed.hand_eye.presentation import hold_out, hold_out_table
from testbed.reporting.console import noted, out, write_json
from vision_pc.config.choices import Detector, Method, Setup
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import judgement
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.board_finder import second_finders
from vision_pc.shell.cameras.grey_files import read_grey
from vision_pc.shell.cameras.picture_files import pictures_in, pictures_of


def _samples(source: SampleSource) -> PosePairs:
    """The samples. Raises RequestRefused naming what cannot be believed."""
    options = ImportOptions(source.setup, source.marker_id, source.camera_in_target, source.normalise)
    if source.camera_file is None:
        pairs = load(source.file, options)
        if pairs.copies:
            whole = len(pairs) + pairs.copies
            note = f"{len(pairs)} moments of {whole} samples: else hand and camera stand as at one of these"
            out.print(note, highlight=False, soft_wrap=True)
        return pairs
    hand = trajectories.load_tum(source.file, source.normalise)
    camera = trajectories.load_tum(source.camera_file, source.normalise)
    pairs, offset = trajectories.pair(hand, camera, _offset(source.offset_s), options)
    out.print(f"{len(pairs)} moments chosen, camera clock {offset:+.4f} s", highlight=False)
    return pairs


def _offset(text: str) -> float | None:
    if text == "estimate":
        return None
    try:
        return written_number(text)
    except ValueError as error:
        raise RequestRefused(
            "refused.hand_eye.format", f"--offset-s is {text!r}: seconds or 'estimate' is wanted"
        ) from error


def run_solve(source: SampleSource, method: Method, as_given: bool, json_file: Path | None) -> bool:
    """Print X and all that is known about it. Returns whether nothing about it is doubtful, or doubts were
    not to count. Raises LongreachError where there is no X to believe.
    """
    pairs = _samples(source)
    try:
        result, found = judgement.believed(pairs, method, as_given)
    except MeasurementFailed as error:
        raise MeasurementFailed(error.cause, f"{source.file.name}: {error}") from error
    out.print(presentation.result_table(result))
    out.print(presentation.sample_table(result))
    noted(f"note: {note}" for note in result.notes)
    results = presentation.result_json(result)
    for line, style in presentation.judgement_lines(found):
        out.print(line, style=style, highlight=False, soft_wrap=True)
    results["verdict"] = presentation.judgement_json(found)
    write_json(json_file, results)
    return as_given or found.verdict == "good"


def run_compare(source: SampleSource, json_file: Path | None) -> None:
    """Print the hold-out errors of all methods. Raises MeasurementFailed where no method has any."""
    pairs = _samples(source)
    rows = hold_out(source.file.stem, pairs)
    if all(row.error for row in rows):
        raise MeasurementFailed("measurement.hand_eye.too_few_samples", f"{source.file}: {rows[0].error}")
    out.print(hold_out_table(rows))
    write_json(json_file, {"rows": rows})


def run_intrinsics_of_pictures(
    files: list[Path], board: PicturedBoard, detector: Detector, json_file: Path | None
) -> None:
    """Print the camera's intrinsics."""
    read, left_out = read_each(pictures_of(files), read_grey)
    pictures = [(file.stem, image) for file, image in read]
    sizes = {image.shape for _, image in pictures}
    if len(sizes) != 1:
        raise RequestRefused(
            "refused.intrinsics.sizes", f"pictures of {len(sizes)} sizes; one camera has one"
        )
    chosen = described_board(board)
    views, missed = detect(pictures, chosen, detector)
    noted([*left_out, *second_finders(views), *(f"no board in {name}" for name in missed)])
    question([image for _, image in pictures], chosen, len(views))
    height, width = pictures[0][1].shape
    found = zhang.calibrate(views, width, height)
    out.print(presentation.view_table(found))
    out.print(presentation.coverage_table(found))
    K, k = found.K, " ".join(f"{value:.6f}" for value in found.distortion)
    out.print(
        f"fx {K[0, 0]:.4f} ± {found.std_px[0]:.2f} fy {K[1, 1]:.4f} cx {K[0, 2]:.4f} cy {K[1, 2]:.4f} px; "
        f"k1 k2 p1 p2 k3 {k}; {found.rms_px:.3f} px rms",
        highlight=False,
        soft_wrap=True,
    )
    figures = {
        "rms_px": found.rms_px, "missed": missed, "outlying": found.outlying, "K": K,
        "distortion": found.distortion, "std_px": found.std_px, "coverage": found.coverage,
        "width_px": width, "height_px": height,
        "view_rms_px": dict(zip(found.names, found.view_rms_px.tolist(), strict=True)),
    }  # fmt: skip
    write_json(json_file, figures)


def run_samples(
    files: tuple[Path, Path, Path], board: PicturedBoard, lines: PoseLines, setup: Setup, to: Path
) -> None:
    """Write the samples of ``files``: pictures, poses, camera. Raises LongreachError naming the file."""
    folder, poses, camera = files
    found = read_robot_poses(poses, lines.poses_as, lines.hand_unit, lines.euler)
    named = pictures_in(folder)
    pictures, left_out = picture_samples.alike(picture_samples.matched(named, found, poses.name))
    noted(left_out)
    height, width = pictures[0].image.shape
    known = picture_samples.read_camera(camera, (width, height))
    if known.bends is not None:
        out.print(
            f"{camera.name}: the lens is no Brown-Conrady: corners are written as a pinhole has them",
            highlight=False,
            soft_wrap=True,
        )
    content, missed = picture_samples.sample_file(pictures, known, described_board(board), setup)
    picture_samples.write_samples(content, missed, to)
