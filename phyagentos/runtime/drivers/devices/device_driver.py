"""The joints of a real robot behind a bus: set-points paced by the clock, rest by the robot's own means.

A vendor's driver is a `Bus`. Time is the machine's, and stands where what was commanded ends: a motion that is not
continued is brought to rest by the server's deadman, as in a simulation. Every set-point is written when it is due.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np
import pydantic
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import DefinitionError, ExecutionError, Problem, raise_any
from phyagentos.geometry import as_pose
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import read_robot
from phyagentos.runtime.models.sources import find_models
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetDriver
from phyagentos.runtime.targets.driver_registry import DriverSite

Array = NDArray[np.float64]
ReturnT = TypeVar("ReturnT")
SettingsT = TypeVar("SettingsT", bound="DeviceSettings")

BRAKING_SHARE = 0.8  # of the acceleration limit
HALT_MAX_S = 2.0  # the longest deceleration to a hold
REST_RAD_S = 0.01  # every joint slower than this is at rest
REST_READINGS = 3  # a control period apart; one may be the turn of a swing
SPEED_TOLERANCE = 1.1  # of a set-point's way in one step against the velocity limit


class DeviceSettings(Authored):
    """What every device needs besides its profile: `settings` of target.yaml.

    Attributes:
        q_min_rad: Least position of each joint [rad].
        q_max_rad: Greatest position of each joint [rad].
        silence_max_s: The robot is lost when its bus carries no state for so long [s].
    """

    q_min_rad: tuple[float, ...]
    q_max_rad: tuple[float, ...]
    silence_max_s: float = pydantic.Field(default=0.2, gt=0.0)


def read_settings(kind: type[SettingsT], profile: TargetProfile) -> SettingsT:
    """The settings of a profile; raises DefinitionError `INVALID_VALUE` with every problem."""
    place = f"{profile.target}/target.yaml: settings"
    try:
        settings = kind.model_validate(profile.settings.model_dump())
    except pydantic.ValidationError as error:
        found = [(".".join(map(str, each["loc"])), str(each["input"]), each["msg"]) for each in error.errors()]
        raise DefinitionError([Problem("INVALID_VALUE", f"{place}.{at}", *rest) for at, *rest in found]) from error
    n = len(profile.arm.joints)
    problems = [
        Problem("INVALID_VALUE", f"{place}.{name}", f"{len(value)} values", f"{n}, one per joint")
        for name, value in settings
        if isinstance(value, tuple) and len(value) != n
    ]
    raise_any(problems)
    return settings


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What a bus carried last: positions and velocities (n_joints,) [rad, rad/s], opening [m].

    `fault` is the robot's own complaint, empty while it has none.
    """

    q_rad: Array
    qd_rad_s: Array
    width_m: float = 0.0
    fault: str = ""


class Bus(ABC):
    """A vendor's wire. Every method raises ExecutionError `TARGET_LOST` when the robot is silent or the bus is cut."""

    @abstractmethod
    def read(self) -> Reading:
        """The present state."""

    @abstractmethod
    def enable(self, q_rad: Array, width_m: float) -> None:
        """Power the drives, which hold this posture."""

    @abstractmethod
    def write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        """Set-points of all joints, to be reached within one step."""

    @abstractmethod
    def stop(self) -> None:
        """The robot's own emergency stop."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus; the drives keep what they hold."""


class ToolCentre:
    """The tool centre point of an arm, which the guard watches, by its MJCF.

    Raises:
        DefinitionError: The model is missing or unreadable.
    """

    def __init__(self, profile: TargetProfile, folder: Path) -> None:
        place, files = f"{profile.target}/target.yaml", find_models(profile, folder)
        found = compile_model(read_robot(profile, folder), *files) if files else None
        kinematics = read_kinematics(found, profile) if found is not None else None
        if found is None or kinematics is None:
            raise DefinitionError.of(
                "UNREADABLE_FILE",
                f"{place}: model",
                repr(profile.model),
                "a MJCF file",
                hint="Copy the robot's model beside its profile; docs/targets.md says where from.",
            )
        self._model, self._data, self.kinematics = found, mujoco.MjData(found), kinematics
        self._q = [found.joint(name).qposadr[0] for name in profile.arm.joints]
        self._site = found.site(profile.tcp).id

    def locate(self, q_rad: Array) -> Pose:
        """Its pose in the world [m], of measured joints (n_joints,) [rad]."""
        self._data.qpos[self._q] = q_rad
        mujoco.mj_kinematics(self._model, self._data)
        return as_pose(self._data.site_xmat[self._site].reshape(3, 3), self._data.site_xpos[self._site])


class DeviceDriver(TargetDriver):
    """One real robot; `name` is the driver's in the registry."""

    def __init__(self, name: str, site: DriverSite, bus: Bus, settings: DeviceSettings, point: ToolCentre) -> None:
        self.profile, self._name, self._clock = site.profile, name, site.clock
        self._bus, self._point = bus, point
        self._low, self._high = np.array(settings.q_min_rad), np.array(settings.q_max_rad)
        self._steps = round(self.profile.control_period_s / self.profile.physics_step_s)
        self._zero_s = math.nan  # when the episode began, on the clock
        self._at_s = self._due_s = 0.0  # the latest moment that was reported; where what was commanded ends
        self._q, self._qd = self._low, np.zeros_like(self._low)  # the latest set-point
        self._reached, self._width_m = self._q, 0.0  # the set-point before, which is to be reached by now
        self._reading: Reading | None = None  # not reported yet

    @property
    @override
    def time_s(self) -> float:
        return min(self._clock.now_s(), self._due_s) - self._zero_s

    @property
    @override
    def is_moving(self) -> bool:
        return bool(self._qd.any())

    @override
    def describe(self) -> wire.Description:
        return self.describe_profile(
            q_min_rad=tuple(self._low.tolist()),
            q_max_rad=tuple(self._high.tolist()),
            mode="realtime",
            kinematics=self._point.kinematics,
            driver=self._name,
        )

    @override
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        """An episode begins where the robot stands; nothing moves."""
        if request.snapshot:
            raise ExecutionError("MALFORMED", "a real robot cannot be put into the state of a snapshot")
        self._take(self._read())
        self._zero_s = self._at_s = self._due_s = self._clock.now_s()
        return wire.Loaded(request.episode, "")

    @override
    def begin(self, session: str, epoch: int) -> None:
        self._take(self._read())
        self._use(lambda: self._bus.enable(self._q, self._width_m))
        self._await_rest()

    @override
    def observe(self, *, truth: bool) -> wire.Observation:
        return wire.Observation(time_s=self.time_s, target=self._describe_state(self._read()))

    @override
    def report(self) -> wire.Step:
        reading, self._reading = self._reading or self._read(), None
        error_rad = float(np.abs(reading.q_rad - self._reached).max())
        return wire.Step(self._at_s - self._zero_s, self._describe_state(reading), error_rad)

    @override
    def snapshot(self) -> None:
        return None

    @override
    def apply(self, command: wire.Command) -> str:
        self._check(command)
        period_s, step_s = self.profile.control_period_s, self.profile.physics_step_s
        start_s = max(self._due_s + (0.0 if self.is_moving else period_s), self._clock.now_s())
        for index, width_m in enumerate(command.gripper_width_m.tolist()):
            self._sleep_until(start_s + index * step_s)
            self._write(command.q_rad[index], command.qd_rad_s[index], width_m)
        self._at_s, self._due_s = start_s + (self._steps - 1) * step_s, start_s + period_s
        self._reading = self._read()
        if self._reading.fault:
            self.halt()
            return "PROTECTIVE_STOP"
        return ""

    def _check(self, command: wire.Command) -> None:
        """Refuse what the joints cannot follow from the present set-point."""
        self.check_set_points(command)
        q, qd, width = command.q_rad, command.qd_rad_s, command.gripper_width_m
        if (q < self._low).any() or (q > self._high).any():
            raise ExecutionError("TARGET_LIMIT", "a set-point leaves the range of its joint")
        limit = SPEED_TOLERANCE * np.array(self.profile.arm.velocity_rad_s)
        ways = np.diff(np.vstack((self._q, q)), axis=0)
        if (np.abs(ways) > limit * self.profile.physics_step_s).any() or (np.abs(qd) > limit).any():
            raise ExecutionError("TARGET_LIMIT", "set-points move or jump faster than the joints may")
        if not 0.0 <= width.min() <= width.max() <= self.profile.gripper.max_width_m + 1e-6:
            raise ExecutionError("TARGET_LIMIT", f"opening outside 0..{self.profile.gripper.max_width_m} m")

    @override
    def hold(self, duration_s: float) -> None:
        if self.is_moving:
            self.halt()
        self._due_s = max(self._due_s, self._clock.now_s()) + duration_s
        self._sleep_until(self._due_s)
        self._at_s = self._due_s

    @override
    def halt(self, category: int = 2) -> None:
        """Set-points slow down, all joints in proportion, then stand."""
        step_s, braking = self.profile.physics_step_s, BRAKING_SHARE * np.array(self.profile.arm.acceleration_rad_s2)
        q, moving = self._q, self._qd
        rows = math.ceil(min(float((np.abs(moving) / braking).max()), HALT_MAX_S) / step_s)
        for row in range(1, rows + 1):
            self._sleep_until(self._due_s)
            qd = moving * (1.0 - row / rows)
            q = np.clip(q + step_s * qd, self._low, self._high)
            self._write(q, qd, self._width_m)
            self._due_s = max(self._due_s, self._clock.now_s()) + step_s
        self._qd = np.zeros_like(q)
        self._await_rest()

    @override
    def emergency_stop(self) -> None:
        """The robot's own stop first, which its bus shows; where that left it is what is held."""
        self._qd = np.zeros_like(self._q)
        self._use(self._bus.stop)
        self._await_rest()
        self._take(self._read())

    @override
    def close(self) -> None:
        self._bus.close()

    def _await_rest(self) -> None:
        """Let time pass until the joints stand in several readings, at most `HALT_MAX_S`."""
        standing, end_s = 0, self._clock.now_s() + HALT_MAX_S
        while standing < REST_READINGS and self._clock.now_s() < end_s:
            standing = standing + 1 if np.abs(self._read().qd_rad_s).max() < REST_RAD_S else 0
            self._clock.sleep(self.profile.control_period_s)
        self._reading, self._reached = None, self._q
        self._at_s = self._due_s = max(self._due_s, self._clock.now_s())

    def _take(self, reading: Reading) -> None:
        """Set-points go on from here, at rest."""
        self._q = self._reached = np.clip(reading.q_rad, self._low, self._high)
        self._qd, self._width_m = np.zeros_like(self._q), reading.width_m

    def _describe_state(self, reading: Reading) -> TargetState:
        return TargetState(
            q_rad=tuple(reading.q_rad.tolist()),
            qd_rad_s=tuple(reading.qd_rad_s.tolist()),
            gripper_width_m=reading.width_m,
            tcp=self._point.locate(reading.q_rad),
        )

    def _sleep_until(self, moment_s: float) -> None:
        while (left_s := moment_s - self._clock.now_s()) > 0.0:
            self._clock.sleep(left_s)

    def _write(self, q_rad: Array, qd_rad_s: Array, width_m: float) -> None:
        self._use(lambda: self._bus.write(q_rad, qd_rad_s, width_m))
        self._reached, self._q, self._qd, self._width_m = self._q, q_rad, qd_rad_s, width_m

    def _read(self) -> Reading:
        return self._use(self._bus.read)

    def _use(self, act: "Callable[[], ReturnT]") -> "ReturnT":
        """Something on the bus; when that is lost, nothing is left to command."""
        try:
            return act()
        except ExecutionError:
            self._qd = np.zeros_like(self._q)
            raise


def open_device(
    name: str, site: DriverSite, kind: type[SettingsT], open_bus: Callable[[SettingsT], Bus]
) -> DeviceDriver:
    """The driver of a robot whose profile has settings of this kind."""
    settings, point = read_settings(kind, site.profile), ToolCentre(site.profile, site.folder)
    return DeviceDriver(name, site, open_bus(settings), settings, point)
