"""Camera poses of somebody else's SLAM by UDP: lines of TUM's form, a datagram one or several."""

import math
import socket
import threading
import time
from collections import deque

from scipy.spatial.transform import Rotation

from foundation.event_log import EventLog
from foundation.numbers_as_written import written_number
from protocol.errors import ConfigurationError
from vision_pc.config.vision import PoseFeedSettings
from vision_pc.core import se3
from vision_pc.core.odometry.foreign_poses import TimedPose

_KEPT = 600
_LONGEST = 8192
_POLL_S = 0.2
_LOG_EVERY_S = 5.0


def pose_of(line: str) -> tuple[float, se3.Array]:
    """Unix time (s) and X_WC (4, 4) of ``t x y z qx qy qz qw``. Raises ValueError."""
    numbers = [written_number(word) for word in line.split()]
    if len(numbers) != 8:
        raise ValueError(f"{line[:80]!r}: not eight finite numbers t x y z qx qy qz qw")
    if not 0.5 < math.hypot(*numbers[4:]) < 2.0:
        raise ValueError(f"{line[:80]!r}: qx qy qz qw is no unit quaternion")
    return numbers[0], se3.transform(Rotation.from_quat(numbers[4:]).as_matrix(), numbers[1:4])


class UdpPoseFeed:
    """Implements ``PoseFeed``: hears at ``settings``' address, in a thread of its own.

    A line that is none, and one whose time is not after the newest, are left out, counted, and
    logged now and then. Raises ConfigurationError (``configuration.port_taken``).
    """

    def __init__(self, settings: PoseFeedSettings, log: EventLog) -> None:
        self._wait_s, self._log = 1e-3 * settings.wait_ms, log
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((settings.host, settings.port))
        except OSError as error:
            self._socket.close()
            where = f"vision.odometry_feed {settings.host}:{settings.port}"
            raise ConfigurationError("configuration.port_taken", f"{where}: {error.strerror}") from error
        self._socket.settimeout(_POLL_S)
        self._news = threading.Condition()
        self._poses: deque[TimedPose] = deque(maxlen=_KEPT)
        self._logged_s, self.refused = -math.inf, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._hear, name="pose-feed", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that it hears at."""
        return int(self._socket.getsockname()[1])

    def poses_to(self, time_ns: int) -> tuple[TimedPose, ...]:
        """The newest poses, once a pose at or after ``time_ns`` has come or the wait is over."""
        with self._news:
            self._news.wait_for(
                lambda: bool(self._poses) and self._poses[-1].time_ns >= time_ns, self._wait_s
            )
            return tuple(self._poses)

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _hear(self) -> None:
        while not self._stop.is_set():
            try:
                data = self._socket.recv(_LONGEST)
            except TimeoutError:
                continue
            except OSError:
                return
            for line in data.decode("ascii", errors="replace").splitlines():
                if line.strip() and not line.startswith("#"):
                    self._take(line)

    def _take(self, line: str) -> None:
        arrived_ns = time.monotonic_ns()
        try:
            unix_s, X_WC = pose_of(line)
        except ValueError as error:
            self._refuse(str(error))
            return
        time_ns = round(1e9 * unix_s) - (time.time_ns() - arrived_ns)
        with self._news:
            if self._poses and time_ns <= self._poses[-1].time_ns:
                self._refuse(f"{line[:80]!r}: its time is not after the newest")
                return
            self._poses.append(TimedPose(time_ns, X_WC, arrived_ns))
            self._news.notify_all()

    def _refuse(self, why: str) -> None:
        self.refused += 1
        now_s = time.monotonic()
        if now_s - self._logged_s > _LOG_EVERY_S:
            self._logged_s = now_s
            self._log.write("pose_refused", "warning", cause="feed.bad_pose", detail=why, count=self.refused)
