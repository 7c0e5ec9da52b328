"""What `longreach hand-eye` does with files: solve, compare, intrinsics."""

from pathlib import Path

import cv2
import numpy as np

from plant_emulator.config.surroundings import CabinetConfig
from plant_emulator.core.camera.cabinet import cabinet_front
from protocol.errors import MeasurementFailed, RequestRefused
from testbed.camera.checking import question
from testbed.cli.options import PicturedBoard, PoseLines, SampleSource
from testbed.hand_eye import picture_samples, presentation, trajectories
from testbed.hand_eye.importer import ImportOptions, load
from testbed.hand_eye.picture_samples import detect, intrinsics_row, intrinsics_table
from testbed.hand_eye.pose_text import read_robot_poses
from testbed.hand_eye.presentation import hold_out, hold_out_table
from testbed.hand_eye.trajectories import PairingOptions
from testbed.reporting.console import out, write_json
from testbed.scenarios.scenario import chosen_overrides, load_settings
from vision_pc.config.choices import Detector, Method, Setup
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import bundle, judgement
from vision_pc.core.hand_eye.solvers.bundle import RobotNoise
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.board_finder import second_finders
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.shell.cameras.directory import read_grey
from vision_pc.shell.cameras.picture_files import pictures_in


def _samples(source: SampleSource) -> PosePairs:
    """The samples. Raises RequestRefused naming what cannot be believed."""
    options = ImportOptions(source.setup, source.marker_id, source.camera_in_target, source.normalise)
    if source.camera_file is None:
        return load(source.file, options)
    hand = trajectories.load_tum(source.file, source.normalise)
    camera = trajectories.load_tum(source.camera_file, source.normalise)
    pairing = PairingOptions(offset_s=_offset(source.offset_s))
    pairs, offset = trajectories.pair(hand, camera, pairing, options)
    out.print(f"{len(pairs)} moments chosen, camera clock {offset:+.4f} s", highlight=False)
    return pairs


def _offset(text: str) -> float | None:
    if text == "estimate":
        return None
    try:
        return float(text)
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
    for note in result.notes:
        out.print(f"note: {note}", style="yellow", highlight=False, soft_wrap=True)
    figures = presentation.result_figures(result)
    if pairs.corners is not None:
        figures["image_space"], doubts = _adjust_in_image_space(pairs, result, as_given)
        found = found.with_doubts(doubts)
    for line, style in presentation.judgement_lines(found):
        out.print(line, style=style, highlight=False, soft_wrap=True)
    figures["verdict"] = presentation.judgement_figures(found)
    write_json(json_file, figures)
    return as_given or found.verdict == "good"


def _adjust_in_image_space(
    pairs: PosePairs, result: HandEyeResult, as_given: bool
) -> tuple[dict[str, object], list[judgement.Doubt]]:
    """What image-space adjustment finds, and what of that is doubtful."""
    noise = result.noise
    robot = None
    if noise is not None and noise.robot_rotation > 0.0 and noise.robot_translation > 0.0:
        robot = RobotNoise(noise.robot_rotation, noise.robot_translation)
    found = bundle.adjust(pairs, result, robot)
    doubt = judgement.corner_doubt(found.pixel_noise)
    if doubt is not None and doubt.refused and not as_given:
        raise MeasurementFailed(doubt.cause, doubt.reason)
    covariance = found.covariance + (0.0 if result.of_lens is None else result.of_lens)
    std = 1e3 * np.sqrt(np.diag(covariance)[:3])
    x, y, z = 1e3 * found.X[:3, 3]
    out.print(
        f"image-space adjustment: {x:.3f} {y:.3f} {z:.3f} mm, standard deviation {std[0]:.3f} {std[1]:.3f} "
        f"{std[2]:.3f} mm, corner noise {found.pixel_noise:.3f} px",
        highlight=False,
        soft_wrap=True,
    )
    figures: dict[str, object] = {
        "X": presentation.pose_figures(found.X),
        "Z": presentation.pose_figures(found.Z),
        "covariance_p_theta": covariance,
        "corner_noise_px": found.pixel_noise,
        "sample_rms_px": found.sample_rms_px,
    }
    return figures, [] if doubt is None else [doubt]


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
    pictures = [(file.stem, read_grey(file)) for file in files]
    sizes = {image.shape for _, image in pictures}
    if len(sizes) != 1:
        raise RequestRefused(
            "refused.intrinsics.sizes", f"pictures of {len(sizes)} sizes; one camera has one"
        )
    chosen = _board(board)
    views, missed = detect(pictures, chosen, detector)
    for line in (*second_finders(views), *(f"no board in {name}" for name in missed)):
        out.print(line, style="yellow", highlight=False, soft_wrap=True)
    question([image for _, image in pictures], chosen, len(views))
    height, width = pictures[0][1].shape
    found = zhang.calibrate(views, width, height)
    name = "charuco" if board.charuco else detector.value
    row = intrinsics_row(files[0].parent.name or ".", name, found, missed)
    out.print(intrinsics_table([row]))
    out.print(presentation.view_table(found))
    out.print(presentation.coverage_table(found))
    K, k = found.K, " ".join(f"{value:.6f}" for value in found.distortion)
    out.print(
        f"fx {K[0, 0]:.4f} fy {K[1, 1]:.4f} cx {K[0, 2]:.4f} cy {K[1, 2]:.4f} px; k1 k2 p1 p2 k3 {k}",
        highlight=False,
        soft_wrap=True,
    )
    fit = {
        "K": K,
        "distortion": found.distortion,
        "std_px": found.std_px,
        "covariance": found.covariance,
        "coverage": found.coverage,
    }
    view_rms_px = dict(zip(found.names, found.view_rms_px.tolist(), strict=True))
    write_json(json_file, row._asdict() | fit | {"view_rms_px": view_rms_px})


def run_samples(
    files: tuple[Path, Path, Path], board: PicturedBoard, lines: PoseLines, setup: Setup, to: Path
) -> None:
    """Write the samples of ``files``: pictures, poses, camera. Raises LongreachError naming the file."""
    pictures, poses, camera = files
    found = read_robot_poses(poses, lines.poses_as, lines.hand_unit, lines.euler)
    named = pictures_in(pictures)
    pairs = picture_samples.matched(named, found, poses.name)
    height, width = read_grey(named[0]).shape
    known = picture_samples.read_camera(camera, (width, height))
    if known.bends is not None:
        out.print(
            f"{camera.name}: the lens is no Brown-Conrady: corners are written as a pinhole has them",
            highlight=False,
            soft_wrap=True,
        )
    content, missed = picture_samples.sample_file(pairs, known, _board(board), setup)
    picture_samples.write_samples(content, missed, to)


def run_drawing(file: Path, scenario: str, config_dir: Path) -> None:
    """Write the front of the scenario's cabinet to ``file``. Raises RequestRefused if there is none."""
    scene = load_settings(config_dir, chosen_overrides(config_dir, scenario, 1, [])).scene
    fronts = [board for board in scene.boards if isinstance(board, CabinetConfig)]
    if not fronts:
        raise RequestRefused("refused.hand_eye.no_drawing", f"scenario {scenario} has no cabinet")
    if not cv2.imwrite(str(file), cabinet_front(fronts[0])):
        raise RequestRefused("refused.hand_eye.no_drawing", f"{file}: cannot be written")
    out.print(f"{file}: texels of {fronts[0].texel_mm} mm", highlight=False)


def _board(board: PicturedBoard) -> Checkerboard | Charuco:
    square_m = 1e-3 * board.square_mm
    if not board.charuco:
        return Checkerboard(board.columns, board.rows, square_m)
    dictionary = _dictionary(board.dictionary)
    return Charuco(board.columns, board.rows, square_m, 1e-3 * board.marker_mm, dictionary)


def _dictionary(name: str) -> int:
    value = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or not isinstance(value, int):
        raise RequestRefused("refused.intrinsics.dictionary", f"OpenCV has no dictionary {name!r}")
    return value
