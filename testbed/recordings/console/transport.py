"""Where a playback stands: playing, paused and moved, as a function of the time that it is told."""

from typing import NamedTuple

from protocol.errors import RequestRefused

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)


class Transport(NamedTuple):
    """Stands ``at_ns`` into a recording of ``length_ns`` at ``since_ns`` of whatever clock it is told.

    ``jumps`` counts how often it was moved otherwise than by playing.
    """

    length_ns: int
    at_ns: int = 0
    since_ns: int = 0
    playing: bool = False
    speed: float = 1.0
    jumps: int = 0

    def position_ns(self, now_ns: int) -> int:
        """How far into the recording it is; at its end it stays there."""
        if not self.playing:
            return self.at_ns
        return min(self.at_ns + round(self.speed * (now_ns - self.since_ns)), self.length_ns)

    def plays(self, now_ns: int) -> bool:
        """Whether it goes on."""
        return self.playing and self.position_ns(now_ns) < self.length_ns

    def changed(
        self,
        now_ns: int,
        playing: bool | None = None,
        at_s: float | None = None,
        speed: float | None = None,
    ) -> "Transport":
        """It from now on; what is None stays. Playing from the end begins anew.

        Raises RequestRefused (``refused.speed``, ``refused.beyond_recording``).
        """
        at_ns, jumps = self.position_ns(now_ns), self.jumps
        if speed is not None and speed not in SPEEDS:
            allowed = ", ".join(f"{each:g}" for each in SPEEDS)
            raise RequestRefused("refused.speed", f"speed {speed:g}: {allowed} are possible")
        if at_s is not None:
            at_ns, jumps = round(1e9 * at_s), jumps + 1
            if not 0 <= at_ns <= self.length_ns:
                why = f"at_s {at_s:g}: the recording lasts from 0 to {1e-9 * self.length_ns:.3f} s"
                raise RequestRefused("refused.beyond_recording", why)
        going = self.playing if playing is None else playing
        if playing and at_ns == self.length_ns and at_s is None:
            at_ns, jumps = 0, jumps + 1
        return self._replace(
            at_ns=at_ns,
            since_ns=now_ns,
            playing=going,
            speed=self.speed if speed is None else speed,
            jumps=jumps,
        )
