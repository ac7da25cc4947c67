"""The port of a target: what a simulation or a device can do, without any question of who may ask.

Upstream: `served_target`, which adds authority, receive log and stops, so that no driver has to. Downstream: a
simulator, a controller, another machine. A driver is found by name (`driver_registry`); `conformance` tests it.
Alternatives rejected: one class per simulator inside the worker (a crash of the physics would take the evidence with
it); gym's `step` (no authority, no expiry, no halt).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from phyagentos.errors import ExecutionError
from phyagentos.runtime.targets.wire import (
    Artefact,
    Capture,
    Command,
    Description,
    Frames,
    Loaded,
    LoadScene,
    Observation,
    RecordedFault,
    Step,
    ToolResult,
)


class TargetDriver(ABC):
    """One body. Calls come one at a time; time moves only in `apply`, `hold`, `halt`, `begin` and `end`.

    A method refuses by raising ExecutionError with a code; nothing has moved then. Units are SI, joints are in the
    order of the profile, poses are in the world frame.
    """

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Time of the body [s]; NaN while no scene is loaded."""

    @property
    @abstractmethod
    def control_period_s(self) -> float:
        """Length of one command [s]."""

    @property
    @abstractmethod
    def is_moving(self) -> bool:
        """Whether the latest command left a motion in its middle, so that another one must follow."""

    @abstractmethod
    def describe(self) -> Description:
        """What the body is, read from what moves it; `driver`, `tools` and `ground_truth` included."""

    @abstractmethod
    def load(self, request: LoadScene) -> Loaded:
        """Begin an episode; a device checks that it stands at home. Never called while a session has authority.

        Raises:
            ExecutionError: `MALFORMED` or `TARGET_LIMIT` for a snapshot that it cannot start from; what stood before
                still stands.
        """

    def begin(self, session: str, epoch: int) -> None:  # noqa: B027 - most drivers need nothing here
        """A session takes authority; its motion begins at rest."""

    @abstractmethod
    def observe(self, *, truth: bool) -> Observation:
        """The present, without a snapshot.

        Args:
            truth: With entities and regions; only asked of a driver that describes itself with `ground_truth`.
        """

    @abstractmethod
    def report(self) -> Step:
        """The present as a controller needs it, with the greatest contact force since the latest report."""

    @abstractmethod
    def snapshot(self) -> Artefact | None:
        """All of its state, from which `load` can go on; None where there is no such thing."""

    def capture(self, request: Capture) -> Frames:
        """The latest frames of its RGB-D cameras; none by default.

        Raises:
            ExecutionError: `UNKNOWN_CAMERA`, `INVALID_CROP`.
        """
        if request.cameras or request.crops:
            raise ExecutionError("UNKNOWN_CAMERA", "the target has no cameras")
        return Frames(())

    @abstractmethod
    def apply(self, command: Command) -> str:
        """Carry out one control period of set-points.

        Args:
            command: Its arrays have any shape and value: the driver checks them.

        Returns:
            Code of the body's own protective stop, when it broke the command off and came to rest; empty otherwise.

        Raises:
            ExecutionError: `MALFORMED`, `TARGET_LIMIT`: nothing moved.
        """

    @abstractmethod
    def hold(self, duration_s: float) -> None:
        """Come to rest, then hold still for `duration_s` [s]."""

    @abstractmethod
    def halt(self, category: int = 2) -> None:
        """Come to rest within the limits, by its own means, and hold.

        Args:
            category: Of the stop (IEC 60204-1, 9.2.2).
        """

    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> ToolResult:
        """Use one of the described tools.

        Raises:
            ExecutionError: `MALFORMED` for arguments that it does not take.
        """
        raise ExecutionError("UNKNOWN_TOOL", f"the target has no tool {name!r}")

    def end(self) -> tuple[RecordedFault, ...]:
        """The session's authority ends: come to rest; faults meanwhile, for the evidence."""
        if self.is_moving:
            self.halt()
        return ()

    def close(self) -> None:  # noqa: B027 - not every driver holds something
        """Let go of files, devices and connections."""
