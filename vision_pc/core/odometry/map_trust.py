"""Whether the poses of a map can be believed, where something large may move before the camera."""

_PROBATION = 20  # [D] pairs: what stands in view from a map's beginning has shown by then that it moves


class MapTrust:
    """What a map's pairs say of whether it shows the world alone.

    ``ambiguous``: its points went two ways before anything foresaw which is the world's, so none of its poses
    can be believed. ``doubted``: that happened in a map before, so what moved may be all that this one sees.
    """

    def __init__(self, doubted: bool) -> None:
        self.ambiguous = False
        self._doubted = doubted
        self._located = 0
        self._unchecked: list[tuple[int, int]] = []  # capture time and next keyframe: one motion was seen
        self._withdrawn: set[int] = set()

    @property
    def is_doubtful(self) -> bool:
        """Whether none of its poses can be believed, or none yet."""
        return self.ambiguous or (self._doubted and self._located < _PROBATION)

    def believes(self, capture_ns: int) -> bool:
        """Whether the pose of the pair taken then stands: two motions were not found in it only later."""
        return not self.is_doubtful and capture_ns not in self._withdrawn

    def located(self) -> None:
        """A pair was located."""
        self._located += 1

    def unresolved(self) -> None:
        """Two motions were seen, and nothing told which is the world's."""
        self.ambiguous |= self._doubted or self._located < _PROBATION

    def checked(self, capture_ns: int, next_keyframe: int, since: int | None, located: bool) -> None:
        """The arm's state was asked of a pair, whether ``located`` or not: two motions seen now, in the map
        ``since`` that keyframe, may have passed for one. Poses from then on stand if found with both known.
        """
        if since is not None:
            self._withdrawn |= {time_ns for time_ns, number in self._unchecked if number > since}
            self._unchecked = [one for one in self._unchecked if one[1] <= since]
        elif located and self._located:  # a map's first pose is right
            self._unchecked.append((capture_ns, next_keyframe))
