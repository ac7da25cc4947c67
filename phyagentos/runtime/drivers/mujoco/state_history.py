"""The recent past of a simulated world, so that a camera can be late.

Upstream: `drive`, which notes every control period. Downstream: `cameras`.
"""

from collections import deque

from phyagentos.runtime.models.camera_model import Array

HISTORY_S = 1.5  # more than the latest camera allowed, with a run of lost frames
_TOLERANCE_S = 1e-9


class StateHistory:
    """Joint positions at past moments.

    It begins anew with each session, so that what a session sees follows from its own beginning, and a recorded one can
    be repeated.
    """

    def __init__(self) -> None:
        self._states: deque[tuple[float, Array]] = deque()

    def begin(self, time_s: float, qpos: Array) -> None:
        """Forget the past; this is the first moment."""
        self._states.clear()
        self.note(time_s, qpos)

    def note(self, time_s: float, qpos: Array) -> None:
        """Keep the joint positions (nq,) of a moment."""
        self._states.append((time_s, qpos.copy()))
        while self._states[0][0] < time_s - HISTORY_S:
            self._states.popleft()

    def find(self, time_s: float) -> tuple[float, Array]:
        """The latest moment up to `time_s`, and its joint positions (nq,); the first one when all are later."""
        for moment in reversed(self._states):
            if moment[0] <= time_s + _TOLERANCE_S:
                return moment
        return self._states[0]
