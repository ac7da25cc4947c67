"""The looks that a bag allows: frames of its cameras as the wire has them, and the robot's state at their stamps.

A frame is given where its picture, its depth, its lens, the camera's place and the joints are had for one stamp, by
clocks that agree. What lacks any of it is left out, with the reason; nothing is guessed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from os.path import commonpath

import numpy as np
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.looks import FORMAT
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.bag import BagCamera, BagSettings
from phyagentos.protocol.world.environment import TargetState
from phyagentos.runtime.perception.bag_reader import (
    EDGE_NS,
    INFO,
    Bag,
    Course,
    Taken,
    decode_color,
    decode_depth,
    find_kind,
)
from phyagentos.runtime.perception.look import Look
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.wire import Capture, Frame, Frames

KINDS = {"color", "depth", "lens"}
REST_NS = 300_000_000  # between the last two looks: an object that both show in one place rests
_OFFSET_PX = 0.5  # ROS counts pixels by their middles, the wire by their edges


class BagLooks:
    """Finds looks in a bag; their time begins at `origin_ns`, and is that of the joint states' clock.

    Attributes:
        cameras: With all their topics.
        left_out: What was not used, with the reason, in words.
    """

    def __init__(self, bag: Bag, how: BagSettings, profile: TargetProfile, robot: RobotMask) -> None:
        self._bag, self._how, self._robot, self._target = bag, how, robot, profile.target
        self._gap_ns, self._age_ns = round(how.state_s * 1e9), round(how.max_age_s * 1e9)
        self._arm = [course for name in profile.arm.joints if (course := find_joint(bag, how, name)) is not None]
        found = {name: find_joint(bag, how, name) for name in profile.gripper.joints}
        self._fingers = {name: course for name, course in found.items() if course is not None}
        self.origin_ns = int(self._arm[0].stamps_ns[0]) if self._arm else 0
        self.left_out: list[str] = []
        lacking = [name for name in profile.arm.joints if find_joint(bag, how, name) is None]
        self.left_out += [f"no states of the joints {', '.join(lacking)}"] if lacking else []
        self.cameras = {} if lacking else self._find_cameras()

    def find_looks(self, scene: Scene) -> list[Look]:
        """At the begin, shortly before the end, and at the end: none without the end, fewer where less is shown."""
        bag, lag_ns = self._bag, self._find_lag(self._bag.end_ns - EDGE_NS, self._bag.end_ns)
        self._drop_transforms(lag_ns)
        if (last := self._look_back(scene, bag.end_ns - lag_ns, lag_ns, self._gap_ns, notes=True)) is None:
            return []
        rest_ns = self.origin_ns + round(min(each.time_s for each in last.captures[0][1].frames) * 1e9) - REST_NS
        first_ns = max(taken[0].stamp_ns for each in self.cameras.values() if (taken := bag.pictures.get(each.color)))
        begin_lag_ns = self._find_lag(bag.begin_ns, bag.begin_ns + EDGE_NS)
        begin = self._look_back(scene, first_ns, begin_lag_ns) if first_ns < rest_ns else None
        return [each for each in (begin, self._look_back(scene, rest_ns, lag_ns), last) if each is not None]

    def _find_lag(self, begin_ns: int, end_ns: int) -> int:
        """How much later than their stamps joint states were recorded in a part of the bag, or in all of it [ns]."""
        if not self._arm:
            return 0
        logged, lags = self._arm[0].stamps_ns + self._arm[0].lags_ns, self._arm[0].lags_ns
        within = lags[(begin_ns <= logged) & (logged <= end_ns)]
        return int(np.median(within if len(within) else lags))

    def _drop_transforms(self, lag_ns: int) -> None:
        """Do without frames of /tf that another clock stamped than the joint states."""
        moving = {name: step for name, (_, step) in self._bag.frames.items() if isinstance(step, Course)}
        why = {name: explain_clock(step.lags_ns, lag_ns, self._how) for name, step in moving.items()}
        self.left_out += [f"transforms of {name}: {each}" for name, each in why.items() if each]
        kept = {name: each for name, each in self._bag.frames.items() if not why.get(name)}
        self._bag = replace(self._bag, frames=kept)

    def _find_cameras(self) -> dict[str, BagCamera]:
        """The cameras of the settings, or one for each frame of pictures in colour; with all their topics."""
        first = {topic: taken[0] for topic, taken in self._bag.pictures.items()}
        types = self._bag.types
        kinds = {topic: "lens" if types[topic] == INFO else find_kind(taken) for topic, taken in first.items()}
        self.left_out += [
            f"{topic}: {kind} is not read" for topic, kind in kinds.items() if kind.startswith("encoding")
        ]
        colors = sorted(
            ((topic.endswith("compressed"), topic) for topic, kind in kinds.items() if kind == "color"), reverse=True
        )
        found = {first[topic].frame.removesuffix("_optical_frame"): BagCamera(color=topic) for _, topic in colors}
        chosen = self._how.cameras or dict(sorted(found.items()))
        self.left_out += [] if chosen else ["no topic has pictures in colour"]

        def find_near(color: str, kind: str) -> str:
            topics = sorted(topic for topic, each in kinds.items() if each == kind)
            same = [each for each in topics if color in first and first[each].frame == first[color].frame]
            return max(same or topics, key=lambda each: len(commonpath([each, color])), default="")

        return {
            name: each.model_copy(
                update={
                    "depth": each.depth or find_near(each.color, "depth"),
                    "info": each.info or find_near(each.color, "lens"),
                }
            )
            for name, each in chosen.items()
        }

    def _look_back(
        self, scene: Scene, at_ns: int, lag_ns: int, ahead_ns: int = 0, *, notes: bool = False
    ) -> Look | None:
        """The newest usable frames up to a stamp, or so little `ahead_ns` of it; none is older than allowed.

        `notes` keeps why cameras have none. The end is known as well as messages take equally long.
        """
        cameras = self.cameras.items()
        found = {name: self._find_frame(name, camera, at_ns, ahead_ns, lag_ns) for name, camera in cameras}
        if notes:
            self.left_out += [f"camera {name}: {each}" for name, each in found.items() if isinstance(each, str)]
        shown = [each for each in found.values() if not isinstance(each, str)]
        if not shown:
            return None
        states = sorted({frame.time_s: state for frame, state in shown}.items(), key=lambda each: each[0])
        return Look(
            phy=FORMAT,
            target=self._target,
            scene=scene,
            before=None,
            objects=(),
            now=states[-1],
            captures=[(Capture(), Frames(tuple(frame for frame, _ in shown)))],
            states=states,
        )

    def _find_frame(
        self, name: str, camera: BagCamera, at_ns: int, ahead_ns: int, lag_ns: int
    ) -> tuple[Frame, TargetState] | str:
        why, pictures = "", self._bag.pictures.get(camera.color, ())
        for taken in sorted(pictures, key=lambda each: -each.stamp_ns):
            reason = explain_clock(taken.logged_ns - taken.stamp_ns, lag_ns, self._how)
            if reason or at_ns - self._age_ns <= taken.stamp_ns <= at_ns + ahead_ns:
                frame = reason or self._make_frame(name, camera, taken)
                if not isinstance(frame, str):
                    return frame
                why = why or frame
        late_s = (at_ns - max((each.stamp_ns for each in pictures), default=0)) / 1e9
        return why or (f"its last picture is {late_s:.2f} s before the end" if pictures else "no picture near the end")

    def _make_frame(self, name: str, camera: BagCamera, taken: Taken) -> tuple[Frame, TargetState] | str:
        """One picture with all that belongs to it, or what it lacks."""
        stamp_ns, how = taken.stamp_ns, self._how
        depth = _find_nearest(self._bag.pictures.get(camera.depth, ()), stamp_ns)
        if depth is None or abs(depth.stamp_ns - stamp_ns) > how.pair_s * 1e9:
            return f"no depth within {how.pair_s:g} s of its pictures"
        if (info := _find_nearest(self._bag.pictures.get(camera.info, ()), stamp_ns)) is None:
            return "no camera_info"
        if {depth.frame, info.frame} != {taken.frame}:
            return f"pictures, depth and lens are in other frames: {taken.frame}, {depth.frame}, {info.frame}"
        pose = camera.pose or self._bag.find_pose(taken.frame, how.world, stamp_ns, self._gap_ns)
        if isinstance(pose, str):
            return pose
        if (state := self._find_state(stamp_ns)) is None:
            return f"no joint states within {how.state_s:g} s before and after its pictures"
        rgb, depth_m, lens = decode_color(taken), decode_depth(depth), info.message
        if rgb is None or depth_m is None or not rgb.shape[:2] == depth_m.shape == (lens.height, lens.width):
            return "picture, depth and camera_info differ in size, or their bytes are damaged"
        is_rectified = "image_rect" in camera.color  # its lens has the distortion that it had
        (fx, _, cx, *_), (_, fy, cy, *_), _ = np.reshape(lens.p if is_rectified else lens.k, (3, -1)).tolist()
        is_distorted = np.any(lens.d) and not is_rectified
        if not min(fx, fy) > 0.0 or is_distorted or max(lens.binning_x, lens.binning_y) > 1 or lens.roi.width:
            return "its camera_info has no focal length, or a distortion, binning or window: record rectified pictures"
        made = Frame(
            camera=name,
            time_s=(stamp_ns - self.origin_ns) / 1e9,
            width=lens.width,
            height=lens.height,
            fx=fx,
            fy=fy,
            cx=cx + _OFFSET_PX,
            cy=cy + _OFFSET_PX,
            world_T_camera=pose,
            rgb=rgb,
            depth_m=depth_m,
        )
        return made, state

    def _find_state(self, stamp_ns: int) -> TargetState | None:
        """The robot at a stamp; the gripper counts as closed where its joints are not recorded."""
        q_rad = [_blend(course, stamp_ns, self._gap_ns) for course in self._arm]
        fingers = {name: _blend(course, stamp_ns, self._gap_ns) for name, course in self._fingers.items()}
        if np.isnan([*q_rad, *fingers.values()]).any():
            return None
        width_m = self._robot.find_width(fingers) if fingers else 0.0
        still = (0.0,) * len(q_rad)
        tool = self._robot.find_tool(q_rad)
        return TargetState(q_rad=tuple(q_rad), qd_rad_s=still, gripper_width_m=width_m, tcp=tool)


def find_joint(bag: Bag, how: BagSettings, name: str) -> Course | None:
    """The states of a joint: of the topic that is named, else of the shortest that ends with `joint_states`."""
    found = sorted((each for each in bag.joints if each.endswith("joint_states")), key=lambda each: (len(each), each))
    topics: Iterable[str] = [how.joint_states] if how.joint_states else found
    courses = (bag.joints.get(topic, {}).get(how.joints.get(name, name)) for topic in topics)
    return next((course for course in courses if course is not None and len(course.stamps_ns)), None)


def explain_clock(lags_ns: NDArray[np.int64] | int, expected_ns: NDArray[np.int64] | int, how: BagSettings) -> str:
    """How far stamps are off by how much later they were recorded, and joint states; empty where clocks agree."""
    off_s, allowed_s = float(np.median(lags_ns) - np.median(expected_ns)) / 1e9, how.clock_s
    way = "behind" if off_s > 0 else "ahead of"
    says = f"stamps {abs(off_s):.2f} s {way} the joint states' clock; clock_s allows {allowed_s:g} s"
    return says if abs(off_s) > allowed_s else ""


def _blend(course: Course, stamp_ns: int, gap_ns: int) -> float:
    """A joint at a stamp [rad] or [m]; NaN where it is not known."""
    before, after, share = course.find(stamp_ns, gap_ns) or (np.full(1, np.nan), np.zeros(1), 0.0)
    return float(before[0] + share * (after[0] - before[0]))


def _find_nearest(taken: Sequence[Taken], stamp_ns: int) -> Taken | None:
    return min(taken, key=lambda each: abs(each.stamp_ns - stamp_ns), default=None)
