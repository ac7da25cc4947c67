"""Leaves that move the arm or the base: through free space, or along a way that was found before."""

import numpy as np
from msgspec.structs import replace
from typing_extensions import override

from phyagentos.geometry import rotate
from phyagentos.protocol.capabilities.targets import BASE_JOINTS, YAW_MAX_RAD
from phyagentos.runtime.execution.leaf import FailureCode, PortInformation, Role, Status
from phyagentos.runtime.execution.planning import BESIDE, MovingLeaf
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Motion,
    MotionRequest,
    Payload,
    PlanMove,
    ShapeTransport,
    TimeLine,
)
from phyagentos.runtime.perception.world_model import BELIEF

HOME_TOLERANCE_RAD = 0.01  # a motion this short is no motion
SIDES = 24  # directions from which a thing may be faced: 15 degrees apart
THERE = 0.005  # metres and radians from a goal at which it is reached
HEADING_MAX_RAD = YAW_MAX_RAD - 0.03  # planning keeps some room to the end of a range; half a turn is 4 degrees off


class MoveHome(MovingLeaf):
    """A collision-free motion home."""

    ROLE = Role.HOME
    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "speed": PortInformation(data_type=float, default_value=1.0, description="Fraction of the velocity limits."),
    }

    def find_goal_rad(self) -> tuple[float, ...]:
        """(n_joints,) where to go [rad], or without the pose of a base, which stays where it is."""
        return self.context.profile.arm.home_rad

    def compose(self) -> MotionRequest | Status:
        """One request."""
        payload = self.find("payload")
        self._held = None if payload is None else payload.entity
        now, asked_rad, first = self.context.commands.q_rad, self.find_goal_rad(), self.context.profile.servoed.start
        goal = np.append(now[:first], asked_rad[len(asked_rad) - len(now) + first :])  # a base stays where it is
        if np.abs(goal - now).max() < HOME_TOLERANCE_RAD:
            return self.succeed("already there")
        return self.request_move(goal[None, :], payload or self.find_held(), self.scale_speed(self.read("speed")))


class MovePosture(MoveHome):
    """A collision-free motion to a named posture."""

    INPUT_PORTS = {
        **MoveHome.INPUT_PORTS,
        "posture": PortInformation(data_type=str, description="Its name in the target's profile."),
        "ignore": PortInformation(data_type=str, required=False, description="The entity that it may touch."),
    }

    @override
    def find_goal_rad(self) -> tuple[float, ...]:
        return self.context.profile.postures[self.read("posture")]

    @override
    def compose(self) -> MotionRequest | Status:
        if (name := self.read("posture")) not in self.context.profile.postures:  # of a tree that names it itself
            return self.fail("UNKNOWN_POSTURE", f"the target has no posture {name!r}")
        request, touched = super().compose(), self.find("ignore")
        return replace(request, ignore=(touched,)) if isinstance(request, PlanMove) and touched else request


class MoveTo(MovingLeaf):
    """A collision-free motion to the best reachable hover posture; reports its approach.

    With a payload it fails with `GRASP_LOST` when the payload leaves the fingers on the way.
    """

    ROLE = Role.MOVE
    INPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Where it may go."),
        "payload": PortInformation(data_type=Payload, required=False, description="What is held, and how."),
        "ignore": PortInformation(data_type=str, required=False, description="Entity that is no obstacle."),
        "speed": PortInformation(data_type=float, default_value=1.0, description="Fraction of the velocity limits."),
        "beside": BESIDE,
    }
    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The approach it hovers at.")}

    def compose(self) -> MotionRequest | Status:
        """One request with all hover postures as goals."""
        payload = self.find("payload")
        ignored = self.find("ignore")
        self._held = None if payload is None else payload.entity
        goals = np.array([approach.line_rad[0] for approach in self.read("approaches").approaches])
        request = self.request_move(goals, payload, self.scale_speed(self.read("speed")))
        return request if ignored is None else replace(request, ignore=(ignored,))

    def on_arrived(self, motion: Motion) -> Status:
        """Report the reached approach."""
        approach = self.read("approaches").approaches[motion.goal]
        self.write("approach", approach)
        return self.succeed("", label=approach.label, **self.describe_motion(motion))


class MoveLinear(MovingLeaf):
    """A straight tool motion. Fails with `GRASP_LOST` when a payload leaves the fingers on the way."""

    ROLE = Role.MOVE
    INPUT_PORTS = {
        "approach": PortInformation(data_type=Approach, description="The line."),
        "direction": PortInformation(data_type=str, default_value="forward", description="`forward` or `back`."),
        "speed": PortInformation(data_type=float, default_value=0.25, description="Fraction of the velocity limits."),
        "payload": PortInformation(data_type=Payload, required=False, description="What must stay in the fingers."),
        "stop_n": PortInformation(
            data_type=float, required=False, description="Contact force at which it stops and fails [N]."
        ),
        "beside": BESIDE,
    }

    def compose(self) -> MotionRequest | Status:
        """Time the line."""
        payload = self.find("payload")
        self._held = None if payload is None else payload.entity
        self._stop_n = self.find("stop_n")
        line = self.read("approach").line_rad
        direction = self.read("direction")
        if direction not in ("forward", "back"):
            raise ValueError(f"direction is {direction!r}; possible: forward, back")
        return TimeLine(
            waypoints_rad=line if direction == "forward" else line[::-1].copy(),
            speed=self.scale_speed(self.read("speed")),
            load=None if payload is None else payload.load,
        )


class MoveLevel(MovingLeaf):
    """The way of an approach, with the tilt of the vessel against its apparent gravity bounded."""

    ROLE = Role.MOVE
    INPUT_PORTS = {
        "approach": PortInformation(data_type=Approach, description="The way."),
        "payload": PortInformation(data_type=Payload, description="What must stay in the fingers."),
        "tilt_max_rad": PortInformation(
            data_type=float, default_value=0.08, description="Largest apparent tilt [rad], accelerations included."
        ),
        "method": PortInformation(
            data_type=str, default_value="casadi", description="`casadi` (shaped) or `toppra` (joint limits only)."
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """Time the way."""
        payload = self.read("payload")
        self._held = payload.entity
        return ShapeTransport(
            waypoints_rad=self.read("approach").line_rad,
            tilt_max_rad=self.read("tilt_max_rad"),
            method=self.read("method"),
            load=payload.load,
        )


class DriveTo(MovingLeaf):
    """A collision-free motion of the base into a region, headed as that, or to a distance of a thing, facing it.

    The arm stays as it is.
    """

    ROLE = Role.MOVE
    INPUT_PORTS = {
        "place": PortInformation(data_type=str, description="Name of a region, or of a thing."),
        "standoff_m": PortInformation(
            data_type=float, default_value=0.4, description="From the centre of a thing [m]."
        ),
        "speed": PortInformation(data_type=float, default_value=1.0, description="Fraction of the velocity limits."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request with every pose that would do as a goal."""
        name, now = self.read("place"), self.context.world.observe(BELIEF)
        place = now.regions.get(name) or now.entities.get(name)
        if place is None:
            return self.fail(FailureCode.OBJECT_GONE, f"{name} is not in the world as observed", object=name)
        x, y, _ = place.pose.position_m
        if name in now.regions:
            ahead = rotate(place.pose.quaternion_wxyz, (1.0, 0.0, 0.0))
            poses = np.array([(x, y, np.arctan2(ahead[1], ahead[0]))])
        else:
            headings = np.linspace(-np.pi, np.pi, SIDES, endpoint=False)
            away = self.read("standoff_m") * np.column_stack((np.cos(headings), np.sin(headings)))
            poses = np.column_stack(((x, y) - away, headings))
        poses[:, 2] = np.clip(poses[:, 2], -HEADING_MAX_RAD, HEADING_MAX_RAD)
        q = self.context.commands.q_rad
        goals = np.tile(q, (len(poses), 1))
        goals[:, : len(BASE_JOINTS)] = poses
        if np.abs(goals - q).max(axis=1).min() < THERE:
            return self.succeed("already there")
        return self.request_move(goals, self.find_held(), self.scale_speed(self.read("speed")))
