"""A data set from bags of ROS 2 that others recorded: joints, commands and pictures on a grid of equal steps of time.

A bag that `paos verify --bag` judged carries its verdict. What has a gap is left out whole; nothing is filled in.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError
from phyagentos.export.demonstrations import Choice, Demonstrations, Episode
from phyagentos.operations.verify_bag import VERDICT, find_robot
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.bag import BagSettings, read_bag_settings
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.perception.bag_looks import BagLooks, explain_clock, find_joint
from phyagentos.runtime.perception.bag_reader import Bag, Course, decode_color, iter_taken, read_bag
from phyagentos.runtime.perception.robot_mask import RobotMask

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
COMMANDS = "joint_commands"  # how the topic of commands ends, where the settings name none
LABELS = {Truth.TRUE: "success", Truth.FALSE: "failure", Truth.UNKNOWN: "unknown"}


class Judged(msgspec.Struct, frozen=True):
    """What of the verdict on a bag its episode carries."""

    verdict: Truth
    criteria: tuple[Criterion, ...]


class _LeftOut(Exception):
    """Why a bag is no episode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagEpisode(Episode):
    """One bag.

    Attributes:
        judged: Its verdict; None where it was never judged.
        commanded: Whether its commands were recorded; else an action is the state one step later.
        shown: By camera its topic, and (n,) the stamp of the picture at each step [ns].
    """

    bag: Path
    judged: Judged | None
    commanded: bool
    shown: Mapping[str, tuple[str, Stamps]]

    @property
    @override
    def origin(self) -> Fields:
        judged = self.judged
        return {
            "bag": str(self.bag),
            "verdict": LABELS[judged.verdict] if judged is not None else "",
            "verdict_reason": "; ".join(f"{each.text}: {each.because}" for each in judged.criteria) if judged else "",
            "action": "commanded" if self.commanded else "the state one step later",
        }

    @override
    def iter_pictures(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        topic, stamps_ns = self.shown[camera]
        taken, shown_ns, rgb = iter_taken(self.bag, topic), -1, np.zeros(0, np.uint8)
        for stamp_ns in stamps_ns.tolist():
            if stamp_ns != shown_ns:
                found = decode_color(next(each for each in taken if each.stamp_ns == stamp_ns))
                if found is None or (rgb.size and rgb.shape != found.shape):
                    broken = f"{topic}: a picture at {stamp_ns} ns that is damaged, or of another size"
                    raise DefinitionError.of("UNREADABLE_FILE", str(self.bag), broken, "pictures of one size")
                shown_ns, rgb = stamp_ns, found
            yield rgb


def read_bags(bags: Sequence[Path], choice: Choice, task: str, *, settings: Path | None = None) -> Demonstrations:
    """Each bag as an episode of this task; those whose verdict is false only with `choice.failures`.

    The robot is `choice.target`, or the only one whose joints the first bag has; `choice.fps` 0 is the rate of the
    first camera, or that of the joint states.

    Raises:
        DefinitionError: `UNKNOWN_NAME`, `MISSING_VALUE`, `INVALID_VALUE`, `EXTRA_MISSING`; `UNREADABLE_FILE`.
    """
    library, how = open_library(), read_bag_settings(settings) if settings is not None else BagSettings()
    first = read_bag(bags[0])
    profile, folder = read_profile(library.get_target(choice.target or find_robot(library, first, how)))
    mask, episodes, left_out = RobotMask(profile, folder), list[BagEpisode](), Counter[str]()
    reader = _Reader(how, profile, mask, choice, task)
    for path in bags:
        try:
            episodes.append(reader.read(path, first if path is bags[0] else read_bag(path)))
        except _LeftOut as reason:
            left_out[f"{path}: {reason}"] += 1
    if not episodes:
        raise DefinitionError.of("INVALID_VALUE", "--from-bag", "; ".join(left_out), "a bag that can be an episode")
    return Demonstrations(
        target=profile.target, names=reader.names, fps=reader.fps, episodes=tuple(episodes), left_out=dict(left_out),
        about="bags of ROS 2 that others recorded",
    )  # fmt: skip


class _Reader:
    """Reads bags of one robot in one form, which the first one sets."""

    def __init__(self, how: BagSettings, profile: TargetProfile, mask: RobotMask, choice: Choice, task: str) -> None:
        self._how, self._profile, self._mask, self._choice, self._task = how, profile, mask, choice, task
        self._joints: tuple[str, ...] = ()
        self.fps = choice.fps

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers of a state."""
        arm = self._profile.arm.joints
        return (*arm, *(["gripper"] if len(self._joints) > len(arm) else []))

    def read(self, path: Path, bag: Bag) -> BagEpisode:
        """A bag as an episode; raises _LeftOut."""
        how, judged = self._how, _find_verdict(path)
        if judged is not None and judged.verdict is Truth.FALSE and not self._choice.failures:
            raise _LeftOut("its verdict is false")
        measured, sent = self._find_courses(bag, how), list[Course]()
        if topic := how.joint_commands or min((each for each in bag.joints if each.endswith(COMMANDS)), default=""):
            sent = self._find_courses(bag, how.model_copy(update={"joint_states": topic}))
        topics = self._find_topics(bag)
        stamps = {name: self._find_stamps(path, topic, measured[0]) for name, topic in topics.items()}
        shown = [*stamps.values(), *(each.stamps_ns for each in measured)]
        self.fps = self.fps or _find_rate(shown[0])
        begin_ns = max(int(each[0]) for each in (*shown, *(each.stamps_ns for each in sent)))
        n = (min(int(each[-1]) for each in shown) - begin_ns) * self.fps // 1_000_000_000
        if n < 1:
            raise _LeftOut("its joints and pictures share less than a step of time")
        grid_ns = begin_ns + np.arange(n + 1) * 1_000_000_000 // self.fps
        state = self._tabulate([self._interpolate(each, grid_ns) for each in measured])
        action = self._tabulate([_hold(each, grid_ns) for each in sent]) if sent else state
        return BagEpisode(
            task=self._task,
            state=state[:-1],
            action=action[1:],
            world=np.zeros(0, np.float32),
            bag=path,
            judged=judged,
            commanded=bool(sent),
            shown={name: (topics[name], self._pick(name, each, grid_ns[:-1])) for name, each in stamps.items()},
        )

    def _find_courses(self, bag: Bag, how: BagSettings) -> list[Course]:
        """Of the arm's joints, and of a finger where the first bag has one."""
        arm, fingers = self._profile.arm.joints, self._profile.gripper.joints
        recorded = [name for name in fingers if find_joint(bag, how, name) is not None]
        self._joints = self._joints or (*arm, *recorded[:1])
        found = {name: find_joint(bag, how, name) for name in self._joints}
        if lacking := [name for name, each in found.items() if each is None]:
            raise _LeftOut(f"{how.joint_states or 'joint states'} without the joints {', '.join(lacking)}")
        return [each for each in found.values() if each is not None]

    def _find_topics(self, bag: Bag) -> dict[str, str]:
        known = BagLooks(bag, self._how, self._profile, self._mask).cameras
        if unknown := [name for name in self._choice.cameras if name not in known]:
            raise _LeftOut(f"no camera {unknown[0]!r}; there are {', '.join(known) or 'none'}")
        return {name: known[name].color for name in self._choice.cameras}

    def _find_stamps(self, path: Path, topic: str, joints: Course) -> Stamps:
        """Stamps of pictures [ns], ascending as they were recorded; raises _LeftOut for those of another clock."""
        taken = [(each.stamp_ns, each.logged_ns - each.stamp_ns) for each in iter_taken(path, topic)]
        stamps_ns, lags_ns = np.array(taken, np.int64).reshape(-1, 2).T
        if len(stamps_ns) < 2:
            raise _LeftOut(f"{topic} has no pictures")
        if why := explain_clock(lags_ns, joints.lags_ns, self._how):
            raise _LeftOut(f"{topic}: {why}")
        newest_ns = np.maximum.accumulate(stamps_ns)
        ascending: Stamps = stamps_ns[np.append(True, stamps_ns[1:] > newest_ns[:-1])]
        return ascending

    def _interpolate(self, course: Course, grid_ns: Stamps) -> Array:
        after = np.clip(np.searchsorted(course.stamps_ns, grid_ns), 1, len(course.stamps_ns) - 1)
        gap_s, longest_s = np.diff(course.stamps_ns)[after - 1].max() / 1e9, self._how.state_s
        if gap_s > longest_s:
            raise _LeftOut(f"a gap of {gap_s:.2f} s in its joint states; state_s is {longest_s:g} s")
        return np.interp(grid_ns, course.stamps_ns, course.values[:, 0])

    def _tabulate(self, columns: Sequence[Array]) -> NDArray[np.float32]:
        """(n, d), the finger as the opening of the gripper [m]."""
        arm, fingers = np.split(np.array(columns), [len(self._profile.arm.joints)])
        name = self._joints[-1]
        widths_m = [[self._mask.find_width({name: each}) for each in course] for course in fingers.tolist()]
        return np.concatenate((arm, np.array(widths_m).reshape(-1, arm.shape[1]))).T.astype(np.float32)

    def _pick(self, camera: str, stamps_ns: Stamps, grid_ns: Stamps) -> Stamps:
        """The latest picture at each step."""
        shown_ns: Stamps = stamps_ns[np.searchsorted(stamps_ns, grid_ns, side="right") - 1]
        longest_s = self._how.max_age_s
        if (old_s := (grid_ns - shown_ns).max() / 1e9) > longest_s:
            raise _LeftOut(f"camera {camera} shows nothing new for {old_s:.2f} s; max_age_s is {longest_s:g} s")
        return shown_ns


def _hold(course: Course, grid_ns: Stamps) -> Array:
    """The latest value at each step."""
    values: Array = course.values[np.searchsorted(course.stamps_ns, grid_ns, side="right") - 1, 0]
    return values


def _find_rate(stamps_ns: Stamps) -> int:
    return max(1, round(1e9 / float(np.median(np.diff(stamps_ns)))))


def _find_verdict(bag: Path) -> Judged | None:
    """What `paos verify --bag` wrote beside a bag."""
    path = bag.with_name(f"{bag.name}_verdict") / VERDICT
    return msgspec.json.decode(path.read_bytes(), type=Judged) if path.is_file() else None
