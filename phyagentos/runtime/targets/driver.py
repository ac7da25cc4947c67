"""The port of a target: what a simulation or a device can do; `served_target` adds authority, receive log and stops.

`VERBS` says for each request which method of a driver answers it, and what the request needs: a served target, a target
of the same process and one that is relayed elsewhere all dispatch by this table.

Alternatives rejected: one class per simulator inside the worker (a crash of the physics would take the evidence with
it); gym's `step` (no authority, no expiry, no halt).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Flag, StrEnum, auto
from typing import Any

import msgspec
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.targets import wire

SETTLE_MAX_S = 60.0


class TargetPort(ABC):
    """One body, at the end of any number of relays. Calls come one at a time; `TargetDriver` is what a driver derives.

    Time moves only in requests that move the target, and in `hold`, `halt` and `end`. A method refuses by an
    ExecutionError with a code; nothing has moved then.

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
    def carry_out(self, request: wire.RequestFor[wire.ReplyT]) -> wire.ReplyT:
        """The reply to one request, which was permitted; never a refusal.

        Raises:
            ExecutionError: The code of a refusal; nothing moved.
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

    @abstractmethod
    def end(self) -> tuple[wire.RecordedFault, ...]:
        """The session's authority ends: come to rest; returns its faults, for the evidence."""

    def close(self) -> None:  # noqa: B027 - not every driver needs it
        """Close files, devices and connections."""


class TargetDriver(TargetPort):
    """A driver of one body: a method for each request, by `VERBS`.

    Units are SI, joints are in the order of the profile, poses are in the world frame. Time moves only in `apply`,
    `hold`, `halt`, `begin` and `end`.
    """

    @override
    def carry_out(self, request: wire.RequestFor[wire.ReplyT]) -> wire.ReplyT:
        if isinstance(request, wire.Command):  # every control period
            stopped, step = self.apply(request), self.report()
            reply: wire.Reply = msgspec.structs.replace(step, stopped=stopped) if stopped else step
        else:
            reply = VERBS[type(request)].method(self, request)
        return wire.require(type(request), reply)

    @abstractmethod
    def describe(self) -> wire.Description:
        """What the body is, from the live model; `driver`, `tools` and `ground_truth` included."""

    def describe_profile(self, **live: Any) -> wire.Description:
        """What its profile says of the body; `live` are the other fields, and those that the live model corrects."""
        profile = self.profile
        stated: Fields = {
            "target": profile.target,
            "n_joints": len(profile.arm.joints),
            "steps_per_command": round(profile.control_period_s / profile.physics_step_s),
            "physics_step_s": profile.physics_step_s,
            "observations": profile.observations,
            "actions": profile.actions,
            "cameras": (),
            "mode": "lockstep",
            "gripper_force_n": profile.gripper.force_n,
            "joints": profile.arm.joints,
            "version": wire.WIRE_VERSION,
            "end_effector": profile.end_effector,
        }
        return wire.Description(**(stated | live))

    def check_set_points(self, command: wire.Command) -> None:
        """Raise `MALFORMED` unless the arrays of a command have the shapes that the profile says, and are finite."""
        steps = round(self.profile.control_period_s / self.profile.physics_step_s)
        shape = (steps, len(self.profile.arm.joints))
        arrays = (command.q_rad, command.qd_rad_s, command.gripper_width_m)
        if tuple(array.shape for array in arrays) != (shape, shape, shape[:1]):
            raise ExecutionError(
                "MALFORMED", message=f"q_rad of shape {command.q_rad.shape}; expected {shape}, and others like it"
            )
        if not all(math.isfinite(value) for array in arrays for value in array.ravel().tolist()):
            raise ExecutionError("MALFORMED", "a set-point is not finite")

    @abstractmethod
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        """Begin an episode; a device begins it where it stands. Never called while a session has authority.

        Raises:
            ExecutionError: `MALFORMED` or `TARGET_LIMIT` for an unusable snapshot; the previous episode stays.
        """

    def begin(self, session: str, epoch: int) -> None:
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
            ExecutionError: `REQUEST_INVALID`.
        """
        if request.cameras or request.crops:
            raise ExecutionError("REQUEST_INVALID", "the target has no cameras")
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

    def follow(self, request: wire.Call | wire.Follow | wire.Cancel) -> wire.Progress:
        """Start, follow or cancel a call; never waits. A driver with procedures cancels them in `halt` and `end`.

        Raises:
            ExecutionError: `REQUEST_INVALID` for a procedure, path or value that does not fit; `BUSY` while it runs.
        """
        raise ExecutionError("REQUEST_INVALID", "the target has no procedures")

    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> wire.ToolResult:
        """Use one of the described tools; raises ExecutionError `MALFORMED` for wrong arguments."""
        raise ExecutionError("REQUEST_INVALID", f"the target has no tool {name!r}")

    @override
    def end(self) -> tuple[wire.RecordedFault, ...]:
        if self.is_moving:
            self.halt()
        return ()


class Need(StrEnum):
    """The authority that a request needs."""

    NOTHING = "nothing"
    SESSION = "session"  # its own, also after a stop
    COMMANDING = "commanding"  # its own, and no stop has ended its commands


class Trait(Flag):
    """What is special about a request."""

    PLAIN = 0
    MOVES = auto()  # it waits for other targets of a shared world, so that it may take long
    SLOW = auto()  # a scene compiles, a picture is rendered
    UNLOGGED = auto()  # changes nothing, and is too frequent for the receive log


@dataclass(frozen=True, slots=True)
class Verb:
    """How one kind of request is answered; `operation` is the one of a session's manifest that permits it, if any."""

    method: Callable[[TargetDriver, Any], wire.Reply]
    needs: Need = Need.NOTHING
    traits: Trait = Trait.PLAIN
    operation: str = ""


def _begin(driver: TargetDriver, request: wire.Begin) -> wire.Ack:
    driver.begin(request.session, request.epoch)
    return wire.Ack()


def _halt(driver: TargetDriver, request: wire.Halt) -> wire.Step:
    if request.is_emergency:
        driver.emergency_stop()
    else:
        driver.halt(request.category)
    return driver.report()


def _settle(driver: TargetDriver, request: wire.Settle) -> wire.Step:
    driver.hold(request.duration_s)
    return driver.report()


def _end(driver: TargetDriver, _: wire.End) -> wire.Ended:
    return wire.Ended(driver.time_s, driver.end())


def _observe(driver: TargetDriver, request: wire.Observe) -> wire.Observation:
    observation = driver.observe(truth=request.truth)
    return msgspec.structs.replace(observation, snapshot=driver.snapshot()) if request.snapshot else observation


def _follow(driver: TargetDriver, request: wire.Call | wire.Follow | wire.Cancel) -> wire.Progress:
    return driver.follow(request)


VERBS: Mapping[type[wire.Request], Verb] = {
    wire.Describe: Verb(lambda driver, _: driver.describe(), traits=Trait.UNLOGGED),
    wire.LoadScene: Verb(lambda driver, request: driver.load(request), traits=Trait.SLOW),
    wire.Begin: Verb(_begin, traits=Trait.MOVES),
    wire.Announce: Verb(lambda driver, request: wire.Admission(driver.announce(request)), Need.COMMANDING, Trait.MOVES),
    wire.Command: Verb(TargetDriver.carry_out, Need.COMMANDING, Trait.MOVES, "apply"),
    wire.Call: Verb(_follow, Need.COMMANDING),
    wire.Follow: Verb(_follow, Need.COMMANDING, Trait.UNLOGGED),
    wire.Cancel: Verb(_follow, Need.SESSION),
    wire.Halt: Verb(_halt, Need.SESSION, Trait.MOVES, "halt"),
    wire.Settle: Verb(_settle, Need.SESSION, Trait.MOVES, "settle"),
    wire.End: Verb(_end, Need.SESSION, Trait.MOVES),
    wire.Observe: Verb(_observe, traits=Trait.UNLOGGED, operation="observe"),
    wire.Capture: Verb(
        lambda driver, request: driver.capture(request), traits=Trait.SLOW | Trait.UNLOGGED, operation="observe"
    ),
    wire.InvokeTool: Verb(
        lambda driver, request: driver.invoke_tool(request.name, request.arguments), traits=Trait.SLOW
    ),
    wire.Shutdown: Verb(lambda _driver, _request: wire.Ack(), traits=Trait.UNLOGGED),
}
