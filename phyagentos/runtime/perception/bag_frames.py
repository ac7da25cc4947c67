"""The moments of a bag at which it can be perceived: frames of its cameras as the wire has them, and the robot's state.

A frame is given where its picture, its depth, its lens, the camera's place and the joints are had for one stamp, by
clocks that agree. What lacks any of it is left out, with the reason; nothing is guessed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os.path import commonpath
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.bag import BagCamera, BagSettings
from phyagentos.protocol.world.environment import TargetState
from phyagentos.runtime.perception.bag_reader import EDGE_S, Bag, Course, Taken, decode_color, decode_depth, find_kind
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.wire import Crop, Frame, Frames, Step

EDGE_NS = round(EDGE_S * 1e9)
REST_S = 0.3  # between the last two looks: an object that both show in one place rests
_DISTORTED = frozenset({"plumb_bob", "rational_polynomial"})  # models of OpenCV
_OFFSET_PX = 0.5  # ROS counts pixels by their middles, the wire by their edges


class ShownFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A frame that was perceived: its stamp [ns since the epoch, or the robot's own zero], and its topics."""

    camera: str
    stamp_ns: int
    color: str
    depth: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Frames that are shown together, where each comes from, and the robot at their stamps; times are a `BagView`'s."""

    time_s: float
    frames: tuple[Frame, ...]
    shown: tuple[ShownFrame, ...]
    states: tuple[tuple[float, TargetState], ...]

    @property
    def step(self) -> Step:
        """The robot at the end of the moment."""
        return Step(time_s=self.time_s, target=self.states[-1][1], tracking_error_rad=0.0)


class BagFrames:
    """Stands in for a target's handle while a bag is perceived, one moment after the other."""

    def __init__(self, moment: Moment) -> None:
        self.moment = moment

    @property
    def latest(self) -> Step:
        """The robot at the moment."""
        return self.moment.step

    step = latest

    def observe(self) -> Step:
        """As `latest`: a bag shows no later moment."""
        return self.moment.step

    def capture(self, cameras: tuple[str, ...] = (), crops: dict[str, Crop] | None = None, every: int = 1) -> Frames:
        """The frames of the moment, or windows of them; raises ExecutionError for thinned ones."""
        if every != 1:
            raise ExecutionError("OBSERVATION_UNAVAILABLE", "a bag shows whole pictures")
        chosen = [each for each in self.moment.frames if each.camera in cameras or not cameras]
        missing = dict.fromkeys(cameras, "OBSERVATION_UNAVAILABLE")
        for each in chosen:
            missing.pop(each.camera, None)
        return Frames(tuple(_cut(each, (crops or {}).get(each.camera)) for each in chosen), missing)


class BagView:
    """Finds moments in a bag. Its time begins with the bag and is that of the joint states' clock.

    `left_out` is what was not used, with the reason, in words; `gripper_known` whether the bag tells the opening.
    """

    def __init__(self, bag: Bag, settings: BagSettings, profile: TargetProfile, robot: RobotMask) -> None:
        self._bag, self._settings, self._robot = bag, settings, robot
        self._gap_ns = round(settings.state_s * 1e9)
        self.left_out: dict[str, None] = {}
        arm = {name: find_joint(bag, settings, name) for name in profile.arm.joints}
        self._arm = [course for course in arm.values() if course is not None]
        fingers = {name: find_joint(bag, settings, name) for name in robot.fingers}
        self._fingers = {name: course for name, course in fingers.items() if course is not None}
        self.gripper_known = bool(self._fingers)
        if lacking := [name for name, course in arm.items() if course is None]:
            self._leave_out(f"no topic has states of the joints {', '.join(lacking)}")
        self.cameras = {} if lacking else self._find_cameras()

    def find_moments(self) -> list[Moment]:
        """At the begin, shortly before the end, and at the end: none without the end, fewer where less is shown."""
        bag = self._bag
        if not self.cameras:
            return []
        if (lag_ns := self._find_lag(bag.end_ns - EDGE_NS, bag.end_ns)) is None:
            self._leave_out(f"no joint states in the last {EDGE_S:g} s")
            return []
        self._drop_transforms(lag_ns)
        last = self._look_back(bag.end_ns - lag_ns, lag_ns, notes=True)
        if last is None:
            return []
        found = [last]
        before_ns = min(each.stamp_ns for each in last.shown) - round(REST_S * 1e9)
        if (before := self._look_back(before_ns, lag_ns)) is not None:
            found.insert(0, before)
        first_ns = [each[0].stamp_ns for camera in self.cameras.values() if (each := bag.images.get(camera.color))]
        lag_ns = self._find_lag(bag.begin_ns, bag.begin_ns + EDGE_NS)
        begin = self._look_back(max(first_ns), lag_ns) if lag_ns is not None and first_ns else None
        if begin is not None and begin.time_s < found[0].time_s:
            found.insert(0, begin)
        return found

    def _leave_out(self, why: str) -> None:
        self.left_out.setdefault(why)

    def _place(self, stamp_ns: int) -> float:
        return float(stamp_ns - int(self._arm[0].stamps_ns[0])) / 1e9

    def _find_lag(self, begin_ns: int, end_ns: int) -> int | None:
        """How much later than their stamps joint states were recorded in a part of the bag [ns]."""
        logged = self._arm[0].stamps_ns + self._arm[0].lags_ns
        lags = self._arm[0].lags_ns[(begin_ns <= logged) & (logged <= end_ns)]
        return int(np.median(lags)) if len(lags) else None

    def _drop_transforms(self, lag_ns: int) -> None:
        """Do without frames of /tf that another clock stamped than the joint states."""
        kept = {}
        for child, (parent, course) in self._bag.moving.items():
            if (why := self._explain_clock(int(np.median(course.lags_ns)), lag_ns)) == "":
                kept[child] = parent, course
            else:
                self._leave_out(f"the transforms of {child}: {why}")
        self._bag = replace(self._bag, moving=kept)

    def _explain_clock(self, lag_ns: int, expected_ns: int) -> str:
        off_s = (lag_ns - expected_ns) / 1e9
        if abs(off_s) <= self._settings.clock_s:
            return ""
        way = "behind" if off_s > 0 else "ahead of"
        return f"stamps {abs(off_s):.2f} s {way} the joint states' clock; clock_s allows {self._settings.clock_s:g} s"

    def _find_cameras(self) -> dict[str, BagCamera]:
        """The cameras with all their topics."""
        by_kind: dict[str, dict[str, str]] = {"color": {}, "depth": {}}
        for topic, taken in self._bag.images.items():
            if (kind := find_kind(taken[0])) in by_kind:
                by_kind[kind][topic] = _read_frame(taken[0])
            else:
                self._leave_out(f"{topic}: pictures of {kind} are not read")
        infos = {topic: _read_frame(taken[0]) for topic, taken in self._bag.infos.items()}
        chosen = dict(self._settings.cameras)
        for topic, frame in sorted(by_kind["color"].items(), key=lambda each: (each[0].endswith("compressed"), each)):
            if not self._settings.cameras:
                chosen.setdefault(frame.removesuffix("_optical_frame") or topic.strip("/"), BagCamera(color=topic))
        if not chosen:
            self._leave_out("no topic has pictures in colour")
        found = {}
        for name, camera in chosen.items():
            frame = by_kind["color"].get(camera.color, "")
            registered = [topic for topic, other in by_kind["depth"].items() if other == frame]
            depth = camera.depth or _find_near(camera.color, registered or [*by_kind["depth"]])
            info = camera.info or _find_near(camera.color, [each for each, other in infos.items() if other == frame])
            found[name] = camera.model_copy(update={"depth": depth, "info": info})
        return found

    def _look_back(self, at_ns: int, lag_ns: int, *, notes: bool = False) -> Moment | None:
        """The newest usable frames up to a stamp, none older than allowed; `notes` keeps why cameras have none."""
        oldest_ns = at_ns - round(self._settings.max_age_s * 1e9)
        shown: list[tuple[Frame, ShownFrame, TargetState]] = []
        for name, camera in self.cameras.items():
            pictures = self._bag.images.get(camera.color, ())
            why = ""
            for taken in sorted(pictures, key=lambda each: -each.stamp_ns):
                reason = self._explain_clock(taken.logged_ns - taken.stamp_ns, lag_ns)
                if not reason and not oldest_ns <= taken.stamp_ns <= at_ns:
                    continue
                frame = reason or self._make_frame(name, camera, taken, lag_ns)
                if not isinstance(frame, str):
                    shown.append(frame)
                    break
                why = why or frame
            else:
                late_s = (at_ns - max((each.stamp_ns for each in pictures), default=0)) / 1e9
                none = f"its last picture is {late_s:.2f} s before the end" if pictures else "no picture near the end"
                if notes:
                    self._leave_out(f"camera {name}: {why or none}")
        if not shown:
            return None
        states = {self._place(each.stamp_ns): state for _, each, state in shown}
        return Moment(
            time_s=max(states),
            frames=tuple(frame for frame, _, _ in shown),
            shown=tuple(each for _, each, _ in shown),
            states=tuple(sorted(states.items(), key=lambda each: each[0])),
        )

    def _make_frame(
        self, name: str, camera: BagCamera, taken: Taken, lag_ns: int
    ) -> tuple[Frame, ShownFrame, TargetState] | str:
        """One picture with all that belongs to it, or what it lacks."""
        stamp_ns, settings, frame = taken.stamp_ns, self._settings, _read_frame(taken)
        depth = _find_nearest(self._bag.images.get(camera.depth, ()), stamp_ns)
        info = _find_nearest(self._bag.infos.get(camera.info, ()), stamp_ns)
        if depth is None or abs(depth.stamp_ns - stamp_ns) > settings.pair_s * 1e9:
            return f"no depth within {settings.pair_s:g} s of its pictures"
        if _read_frame(depth) != frame:
            return f"its depth is in the frame {_read_frame(depth)}, its pictures in {frame}: they are not registered"
        if info is None:
            return "no camera_info"
        if reason := self._explain_clock(depth.logged_ns - depth.stamp_ns, lag_ns):
            return f"its depth: {reason}"
        pose = camera.pose or self._bag.find_pose(frame, settings.world, stamp_ns, self._gap_ns)
        if isinstance(pose, str):
            return pose
        if (state := self._find_state(stamp_ns)) is None:
            return f"no joint states within {settings.state_s:g} s before and after its pictures"
        rgb, depth_m = decode_color(taken), decode_depth(depth)
        picture = _rectify(rgb, depth_m, info.message)
        if isinstance(picture, str):
            return picture
        rgb, depth_m, (fx, fy, cx, cy) = picture
        made = Frame(
            camera=name,
            time_s=self._place(stamp_ns),
            width=rgb.shape[1],
            height=rgb.shape[0],
            fx=fx,
            fy=fy,
            cx=cx + _OFFSET_PX,
            cy=cy + _OFFSET_PX,
            world_T_camera=pose,
            rgb=rgb,
            depth_m=depth_m,
        )
        return made, ShownFrame(camera=name, stamp_ns=stamp_ns, color=camera.color, depth=camera.depth), state

    def _find_state(self, stamp_ns: int) -> TargetState | None:
        """The robot at a stamp; its speed is that between two states."""
        found = [course.find(stamp_ns, self._gap_ns) for course in self._arm]
        fingers = {name: course.find(stamp_ns, self._gap_ns) for name, course in self._fingers.items()}
        if None in found or None in fingers.values():
            return None
        q_rad = tuple(_blend(each) for each in found)
        positions = {name: _blend(each) for name, each in fingers.items()}
        return TargetState(
            q_rad=q_rad,
            qd_rad_s=(0.0,) * len(q_rad),
            gripper_width_m=self._robot.find_width(positions) if positions else 0.0,
            tcp=self._robot.find_tool(q_rad),
        )


def find_joint(bag: Bag, settings: BagSettings, name: str) -> Course | None:
    """The states of a joint: of the topic that is named, else of the shortest that ends with `joint_states`."""
    found = sorted((each for each in bag.joints if each.endswith("joint_states")), key=lambda each: (len(each), each))
    topics = [settings.joint_states] if settings.joint_states else found
    courses = (bag.joints.get(topic, {}).get(settings.joints.get(name, name)) for topic in topics)
    return next((course for course in courses if course is not None), None)


def _blend(found: Any) -> float:
    before, after, share = found
    return float(before[0] + share * (after[0] - before[0]))


def _read_frame(taken: Taken) -> str:
    return str(taken.message.header.frame_id).strip("/")


def _find_near(topic: str, others: Sequence[str]) -> str:
    """The topic whose name begins as another's; empty without any."""
    return max(sorted(others), key=lambda each: len(commonpath([each, topic])), default="")


def _find_nearest(taken: Sequence[Taken], stamp_ns: int) -> Taken | None:
    return min(taken, key=lambda each: abs(each.stamp_ns - stamp_ns), default=None)


def _rectify(
    rgb: NDArray[np.uint8] | None, depth_m: NDArray[np.float32] | None, info: Any
) -> tuple[NDArray[np.uint8], NDArray[np.float32], tuple[float, ...]] | str:
    """Picture and depth without the distortion of the lens, and (fx, fy, cx, cy); or why there are none."""
    size = (info.height, info.width)
    if rgb is None or depth_m is None:
        return "the bytes of its pictures or depths are damaged"
    if rgb.shape[:2] != depth_m.shape or depth_m.shape != size:
        sizes = ", ".join(f"{width} x {height}" for height, width in (rgb.shape[:2], depth_m.shape, size))
        return f"picture, depth and camera_info differ in size: {sizes}"
    k = np.array(info.k, np.float64).reshape(3, 3)
    if not (np.isfinite(k).all() and k[0, 0] > 0.0 and k[1, 1] > 0.0):
        return "its camera_info has no focal length"
    if max(info.binning_x, info.binning_y) > 1 or info.roi.width or info.roi.height:
        return "its pictures are binned or cut out"
    if np.any(info.d):
        if info.distortion_model not in _DISTORTED:
            return f"its lens is of the model {info.distortion_model!r}, which is not read"
        maps = cv2.initUndistortRectifyMap(k, np.array(info.d), np.eye(3), k, size[::-1], cv2.CV_32FC1)
        blank = float("nan")
        rgb = cv2.remap(rgb, *maps, cv2.INTER_LINEAR).astype(np.uint8)
        depth_m = cv2.remap(depth_m, *maps, cv2.INTER_NEAREST, borderValue=blank).astype(np.float32)
    return rgb, depth_m, (k[0, 0].item(), k[1, 1].item(), k[0, 2].item(), k[1, 2].item())


def _cut(frame: Frame, crop: Crop | None) -> Frame:
    if crop is None:
        return frame
    left, top, width, height = crop
    rows, columns = slice(top, top + height), slice(left, left + width)
    return msgspec.structs.replace(
        frame,
        width=width,
        height=height,
        cx=frame.cx - left,
        cy=frame.cy - top,
        rgb=frame.rgb[rows, columns],
        depth_m=frame.depth_m[rows, columns],
    )
