"""The complete input of one look at the world, from which it can be perceived again."""

from typing import Protocol

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.runtime.targets.wire import Capture, Crop, Frames, Observation, Step

Moment = tuple[float, TargetState]
"""A time [s], and the target's state then."""


class FrameSource(Protocol):
    """Inputs of perception: the target's own state, and its cameras."""

    @property
    def latest(self) -> Step | None:
        """The latest step of the session that has authority; None without a session."""

    @property
    def step(self) -> Step:
        """As `latest`; raises ExecutionError without a session."""

    def observe(self) -> Observation | Step:
        """All sensors now."""

    def capture(self, cameras: tuple[str, ...] = (), crops: dict[str, Crop] | None = None, every: int = 1) -> Frames:
        """The latest frames of these cameras; of all when none is named."""


class Look(msgspec.Struct, kw_only=True, omit_defaults=True, eq=False):
    """One look: the state before it and the readings during it, in their order; `look.json` of its file.

    Attributes:
        phy: Format of this record.
        before: The belief before; None at first.
        objects: The scope, sorted; empty for everything.
        now: Time [s] and the target's state at the request.
        captures: Requests to the cameras, and their frames.
        moments: Later times [s] and states that were read during the look (realtime).
        states: Earlier times [s] and states that frames were matched with.
        file: Its path once written, empty in the file itself; `sha256` is of that file.
    """

    phy: str
    target: str
    scene: Scene
    before: Environment | None
    objects: tuple[str, ...] = msgspec.field(name="things")
    now: Moment
    captures: list[tuple[Capture, Frames]] = []
    moments: list[Moment] = []
    states: list[Moment] = []
    file: str = ""
    sha256: str = ""


class RecordedFrames:
    """Replays the readings of one look; stands in for the handle when that look is perceived again."""

    def __init__(self, look: Look) -> None:
        self.latest = self.step = _make_step(look.now)
        self._captures, self._moments = iter(look.captures), iter(look.moments)

    def observe(self) -> Step:
        """The next later moment; raises ExecutionError when there is none."""
        moment = next(self._moments, None)
        if moment is None:
            raise ExecutionError("CHANGED", "perception now reads the target's state once more than it did then")
        return _make_step(moment)

    def capture(self, cameras: tuple[str, ...] = (), crops: dict[str, Crop] | None = None, every: int = 1) -> Frames:
        """The recorded frames; raises ExecutionError for another request than then."""
        asked = Capture(cameras=cameras, crops=crops or {}, every=every)
        then, frames = next(self._captures, (None, Frames(())))
        if then != asked:
            raise ExecutionError("CHANGED", f"perception now asks for {asked}; then it asked for {then}")
        return frames


def _make_step(now: Moment) -> Step:
    return Step(time_s=now[0], target=now[1], tracking_error_rad=0.0)
