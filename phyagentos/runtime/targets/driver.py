"""The port of a target: what a simulation or a device can do; `served_target` adds authority, receive log and stops.

Alternatives rejected: one class per simulator inside the worker (a crash of the physics would take the evidence with
it); gym's `step` (no authority, no expiry, no halt).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.targets import wire


class TargetDriver(ABC):
    """One body. Calls come one at a time; time moves only in `apply`, `hold`, `halt`, `begin` and `end`.

    A method refuses by an ExecutionError with a code; nothing has moved then. Units are SI, joints are in the order of
    the profile, poses are in the world frame.

    A motion that waits for other targets calls `is_ending`, whether the session is to end, and no other one may: a
    command may wait behind it. It refuses with `ABORTED` then.
    """

    profile: TargetProfile
    is_ending: Callable[[], bool] = staticmethod(lambda: False)

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Time of the body [s]; NaN while no scene is loaded."""

    @property
    def control_period_s(self) -> float:
        """Length of one command [s]."""
        return self.profile.control_period_s

    @property
    @abstractmethod
    def is_moving(self) -> bool:
        """Whether the latest command left the body in motion, so that another one must follow."""

    @abstractmethod
    def describe(self) -> wire.Description:
        """What the body is, from the live model; `driver`, `tools` and `ground_truth` included."""

    @abstractmethod
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        """Begin an episode; a device begins it where it stands. Never called while a session has authority.

        Raises:
            ExecutionError: `MALFORMED` or `TARGET_LIMIT` for an unusable snapshot; the previous episode stays.
        """

    def begin(self, session: str, epoch: int) -> None:  # noqa: B027 - most drivers need nothing here
        """A session takes authority; its motion begins at rest."""

    @abstractmethod
    def observe(self, *, truth: bool) -> wire.Observation:
        """The present, without a snapshot; `truth` adds entities and regions, where `ground_truth` is described."""

    @abstractmethod
    def report(self) -> wire.Step:
        """The present for a controller, with the maximum contact force since the latest report."""

    @abstractmethod
    def snapshot(self) -> wire.Artefact | None:
        """The whole state, from which `load` can start; None where the driver has none."""

    def capture(self, request: wire.Capture) -> wire.Frames:
        """The latest frames of its RGB-D cameras; none by default.

        Raises:
            ExecutionError: `UNKNOWN_CAMERA`, `INVALID_CROP`.
        """
        if request.cameras or request.crops:
            raise ExecutionError("UNKNOWN_CAMERA", "the target has no cameras")
        return wire.Frames(())

    def announce(self, motion: wire.Announce) -> str:
        """Admit a motion that is about to be commanded; a driver without neighbours admits any.

        Returns:
            The robot that is in its way; empty when it is admitted.
        """
        return ""

    @abstractmethod
    def apply(self, command: wire.Command) -> str:
        """Carry out one control period of set-points; the driver checks shapes and values of their arrays.

        Returns:
            Code of the body's own protective stop, after which it is at rest; empty otherwise.

        Raises:
            ExecutionError: `MALFORMED`, `TARGET_LIMIT`: nothing moved.
        """

    def send_ahead(self, request: wire.Request) -> bool:
        """Take a request before its turn, in order; whether it was taken. What is lost then, its own call meets."""
        return False

    @abstractmethod
    def hold(self, duration_s: float) -> None:
        """Come to rest, then hold still for `duration_s` [s]."""

    @abstractmethod
    def halt(self, category: int = 2) -> None:
        """Come to rest within the limits, by its own means, and hold; stop category of IEC 60204-1, 9.2.2."""

    def emergency_stop(self) -> None:
        """The emergency stop is latched, and a session has authority: as `halt`; a device also stops by its own."""
        if self.is_moving:
            self.halt()

    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> wire.ToolResult:
        """Use one of the described tools; raises ExecutionError `MALFORMED` for wrong arguments."""
        raise ExecutionError("UNKNOWN_TOOL", f"the target has no tool {name!r}")

    def end(self) -> tuple[wire.RecordedFault, ...]:
        """The session's authority ends: come to rest; returns its faults, for the evidence."""
        if self.is_moving:
            self.halt()
        return ()

    def close(self) -> None:  # noqa: B027 - not every driver needs it
        """Close files, devices and connections."""
