"""Pairs of pictures of a stereo camera: read from directories, or rendered by the emulation."""

import asyncio
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from foundation.foreign_text import read_each
from plant_emulator.config.scene import SceneConfig
from plant_emulator.config.surroundings import AnyBoardConfig, CharucoConfig, CheckerboardConfig
from plant_emulator.core.camera.boards import board_pose
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from protocol.errors import ConfigurationError, MeasurementFailed
from testbed.reporting.console import bars, noted, out, promised
from vision_pc.application.annotate import png
from vision_pc.config.camera import CameraSettings
from vision_pc.core import se3
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception.april_grid import AprilGrid, Board
from vision_pc.core.perception.board_finder import find_board, second_finders
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import StereoPair
from vision_pc.shell.cameras import open_camera
from vision_pc.shell.cameras.grey_files import read_pair
from vision_pc.shell.cameras.picture_files import matched_pictures, pictures_in
from vision_pc.shell.cameras.uvc import halves

LIVE = "live"
Item = TypeVar("Item")


class Taken(NamedTuple):
    """Pairs with their names; ``stamped``: their capture times come from the camera or its recording."""

    names: list[str]
    pairs: list[StereoPair]
    stamped: bool


def take(source: str, settings: CameraSettings, most: int) -> Taken:
    """At most ``most`` pairs of ``source``: ``live`` (as configured), a device's number, a film, or a
    directory.

    A directory holds ``left`` and ``right`` with as many pictures each, or pictures named ``left…`` and
    ``right…``. Raises ConfigurationError, FrameRefused and LinkLost.
    """
    if source == LIVE or source.isdigit():
        device = settings if source == LIVE else settings.model_copy(update={
            "source": "uvc", "uvc": settings.uvc.model_copy(update={"device": int(source)})})  # fmt: skip
        pairs = asyncio.run(_live(device, most))
        return Taken([f"frame {pair.frame_id}" for pair in pairs], pairs, True)
    path = Path(source)
    if path.is_dir():
        return _pictures(path, most)
    if not path.exists():
        raise ConfigurationError("configuration.no_recording", f"{path}: no such directory, film or device")
    pairs = _film(path, most)
    return Taken([f"picture {pair.frame_id}" for pair in pairs], pairs, False)


def _spread(items: list[Item], most: int) -> list[Item]:
    """At most ``most`` of them, evenly over all."""
    return [items[k] for k in np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int)]


def _pictures(directory: Path, most: int) -> Taken:
    """Raises ConfigurationError where it holds no pairs."""
    folders = (directory / "left", directory / "right")
    if all(folder.is_dir() for folder in folders):
        left, right = (pictures_in(folder) for folder in folders)
    else:
        every = pictures_in(directory)
        left, right = ([p for p in every if p.name.lower().startswith(eye)] for eye in ("left", "right"))
    if not left or not right:
        raise ConfigurationError(
            "configuration.bad_recording",
            f"{directory}: {len(left)} pictures of the left eye and {len(right)} of the right one; wanted "
            "are folders left and right, or files left… and right…",
        )
    files, notes = matched_pictures(left, right)
    noted(f"{directory}: {note}" for note in notes)
    chosen = _spread([(left[i], right[j], i) for i, j in files], most)
    read, unread = read_each(chosen, lambda of: read_pair(of[0], of[1], 0, of[2]))
    noted(f"{directory}: {note}" for note in unread)
    pairs = [pair for _, pair in read]
    return Taken([left[pair.frame_id].name for pair in pairs], pairs, False)


def _film(path: Path, most: int) -> list[StereoPair]:
    film = cv2.VideoCapture(str(path))
    try:
        if not film.isOpened():
            raise ConfigurationError("configuration.bad_recording", f"{path}: no film that can be decoded")
        pictures = iter(film.read, (False, None))
        pairs = [
            StereoPair(*halves(np.asarray(picture, dtype=np.uint8), str(path)), 0, number)
            for number, (_, picture) in enumerate(pictures, 1)
        ]
    finally:
        film.release()
    return _spread(pairs, most)


async def _live(settings: CameraSettings, most: int) -> list[StereoPair]:
    camera = open_camera(settings)
    await camera.start()
    found: list[StereoPair] = []
    try:
        async for pair in camera.pairs():
            found.append(pair._replace(left=pair.left.copy(), right=pair.right.copy()))
            if len(found) >= most:
                break
    finally:
        await camera.close()
    return found


def boards_in(taken: Taken, board: Board) -> tuple[list[PairView], list[str]]:
    """The boards that both eyes see, whose corners are exact points, and the names of pairs without one."""
    views: list[PairView] = []
    missed: list[str] = []
    with bars() as shown, shown.step("looking for the board") as bar:
        for k, (name, pair) in enumerate(zip(taken.names, taken.pairs, strict=True)):
            try:
                left, right = (find_board(picture, board, name) for picture in (pair.left, pair.right))
                views.append(stereo_fit.paired(left, right))
            except MeasurementFailed:
                missed.append(name)
            bar.update((k + 1) / len(taken.pairs), f"{len(views)} boards in both eyes")
    noted(second_finders(views))
    return views, missed


_PERIOD_NS = 100_000_000
_BEHIND = se3.transform(np.eye(3), (0.0, 0.0, -5.0))  # the tool marker, out of sight
_RIM_PX = 6.0
_TRIES = 4000
_AWAY_M = (0.9, 1.3)  # from the object, as on the arm when it looks
_ASIDE_M = ((0.15, 0.22), (-0.08, 0.08))  # to the right of the object: the tool's marker hides none of it
_TURNED_DEG = 4.0


def board_pairs(scene: SceneConfig, board: Checkerboard | Charuco, count: int, seed: int) -> list[StereoPair]:
    """``count`` pairs of ``board``, whole in both eyes of the scene's camera, in places and tilts drawn by
    ``seed``.
    """
    config = scene.model_copy(update={"boards": (board_config(board),), "passers": ()})
    eyes = StereoCamera(config.camera, Scene(config), seed)
    rng = np.random.default_rng([seed, 0x626F61])
    X_WP = eyes.scene.mounts.X_WO @ board_pose(config.boards[0])
    places = [X_WP @ se3.inverse(_view(eyes, board, X_WP, rng)) for _ in range(count)]
    return _rendered(eyes, [(X_WC, X_WC @ _BEHIND) for X_WC in places], "rendering boards")


def _rendered(eyes: StereoCamera, places: list[tuple[Array, Array]], what: str) -> list[StereoPair]:
    """A pair from each place of camera and tool marker (X_WC, X_WM)."""
    pairs: list[StereoPair] = []
    with bars() as shown, shown.step(what) as bar:
        for k, (X_WC, X_WM) in enumerate(places, 1):
            left, right = eyes.render(X_WC, X_WM, k)
            pairs.append(StereoPair(left, right, k * _PERIOD_NS, k))
            bar.update(k / len(places))
    return pairs


def marker_pairs(scene: SceneConfig, count: int, seed: int) -> list[StereoPair]:
    """``count`` pairs of the object's markers and the tool's, as the scene's camera sees them on an arm that
    rests before the wall, in a place drawn by ``seed``.
    """
    eyes = StereoCamera(scene.camera, Scene(scene), seed)
    mounts, rng = eyes.scene.mounts, np.random.default_rng([seed, 0x6D61726B])
    turn = se3.exp_so3(np.radians(rng.uniform(-_TURNED_DEG, _TURNED_DEG, 3)))
    place = [rng.uniform(*between) for between in (*_ASIDE_M, _AWAY_M)]
    X_WC = mounts.X_WO @ se3.transform(np.diag([1.0, -1.0, -1.0]) @ turn, place)
    X_WM = X_WC @ se3.inverse(mounts.X_TC) @ mounts.X_TM
    return _rendered(eyes, [(X_WC, X_WM)] * count, "rendering markers")


def _view(eyes: StereoCamera, board: Checkerboard | Charuco, X_WP: Array, rng: np.random.Generator) -> Array:
    """X_CP (4, 4), the board's middle before the camera, with all of it in both pictures."""
    camera = eyes.config
    extent = np.array([board.columns + 2, board.rows + 2]) * board.square_m
    half = 0.5 * extent
    rim = np.array([[x, y, 0.0] for x in (-half[0], 0.0, half[0]) for y in (-half[1], 0.0, half[1])])
    for _ in range(_TRIES):
        turn = se3.exp_so3(np.radians(rng.uniform([-45.0, -45.0, -30.0], [45.0, 45.0, 30.0])))
        depth = rng.uniform(1.1, 2.2) * camera.lens.fx_px * extent[0] / camera.width_px
        pixel = rng.uniform((0.0, 0.0), (camera.width_px, camera.height_px))
        ray = (pixel - (camera.lens.cx_px, camera.lens.cy_px)) / (camera.lens.fx_px, camera.lens.fy_px)
        X_CP = se3.transform(turn @ np.diag([1.0, -1.0, -1.0]), (*(ray * depth), depth))
        X_WC = X_WP @ se3.inverse(X_CP)
        seen = np.concatenate(eyes.project(X_WC, se3.apply(X_WP, rim)))
        inside = (seen > _RIM_PX) & (seen < np.array([camera.width_px, camera.height_px]) - _RIM_PX)
        if np.isfinite(seen).all() and inside.all():
            return X_CP
    raise ConfigurationError("configuration.bad_board", "the board does not fit into both pictures")


def board_config(board: Checkerboard | Charuco) -> AnyBoardConfig:
    """The emulator's description of ``board``, 5 cm before the wall's middle. Raises ConfigurationError."""
    where = {
        "position_m": (0.0, 0.0, 0.05),
        "columns": board.columns,
        "rows": board.rows,
        "square_m": board.square_m,
    }
    if not isinstance(board, Charuco):
        return CheckerboardConfig.model_validate({"kind": "checkerboard", **where})
    names = {getattr(cv2.aruco, name): name for name in ("DICT_5X5_100", "DICT_5X5_1000")}
    if board.dictionary not in names:
        raise ConfigurationError(
            "configuration.bad_board", "boards are emulated of DICT_5X5_100 and DICT_5X5_1000"
        )
    marker = {"marker_m": board.marker_m, "dictionary": names[board.dictionary]}
    return CharucoConfig.model_validate({"kind": "charuco", **where, **marker})


def run_emulate(scene: SceneConfig, board: Board | None, count: int, seed: int, to: Path) -> None:
    """Write pairs of ``board``, or of the markers where it is None, to ``to``: a film where it ends in .avi,
    else a directory of pictures.
    """
    if isinstance(board, AprilGrid):
        raise ConfigurationError("configuration.bad_board", "an AprilGrid is not emulated")
    pairs = marker_pairs(scene, count, seed) if board is None else board_pairs(scene, board, count, seed)
    if to.suffix.lower() == ".avi":
        write_whole_film(pairs, promised(to))
    else:
        promised(to).mkdir(parents=True, exist_ok=True)
        for pair in pairs:
            for eye, picture in (("left", pair.left), ("right", pair.right)):
                (to / f"{eye}{pair.frame_id:04d}.png").write_bytes(png(picture))
    what = "the markers" if board is None else "a board"
    out.print(f"{to}: {len(pairs)} raw pairs of {what}", highlight=False)


def write_whole_film(pairs: list[StereoPair], to: Path) -> None:
    """Both eyes side by side, as a ZED delivers them."""
    height, width = pairs[0].left.shape
    film = cv2.VideoWriter(str(to), cv2.VideoWriter.fourcc(*"MJPG"), 1e9 / _PERIOD_NS, (2 * width, height))
    film.set(cv2.VIDEOWRITER_PROP_QUALITY, 100.0)
    if not film.isOpened():
        raise ConfigurationError("configuration.unwritable", f"{to}: no film can be written there")
    for pair in pairs:
        film.write(cv2.cvtColor(np.hstack([pair.left, pair.right]), cv2.COLOR_GRAY2BGR))
    film.release()
    require_whole(to, len(pairs))


def require_whole(film: Path, count: int) -> None:
    """Raises ConfigurationError unless the AVI's parts are as long as they say: OpenCV says nothing of a full
    disk.
    """
    size, at = film.stat().st_size, 0
    with film.open("rb") as parts:
        while at < size:  # RIFF; longer films have several
            parts.seek(at + 4)
            at += 8 + int.from_bytes(parts.read(4), "little")
    if at != size or not size:
        raise ConfigurationError("output.unwritable", f"{film}: not all of {count} pairs: is the disk full?")
