"""When those who do not come first are served: so seldom that their work stays a share of the time."""


class Turns:
    """Turns at least ``turn_ns`` apart, and further apart the longer they take.

    What a turn cost, and what was spent on the others since the one before, is at most ``share`` of the time
    until the next one begins, however slow the machine is.
    """

    def __init__(self, turn_ns: int, share: float) -> None:
        self.next_ns = 0
        self._turn_ns = turn_ns
        self._share = share
        self._beside_ns = 0

    def spent(self, cost_ns: int) -> None:
        """Note time spent on the others outside a turn."""
        self._beside_ns += cost_ns

    def took(self, began_ns: int, ended_ns: int) -> None:
        """Note a turn: ``next_ns`` is the earliest beginning of the one after."""
        cost_ns = ended_ns - began_ns + self._beside_ns
        self._beside_ns = 0
        self.next_ns = began_ns + max(self._turn_ns, int(cost_ns / self._share))
