"""A robot of LeRobot in the units of its profile: what it observes, and what it is sent."""

import contextlib
import inspect
import math
import pkgutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import draccus
import lerobot.cameras
import lerobot.robots
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.utils.import_utils import register_third_party_plugins
from target_server.settings import SettingsError
from target_server.wire import Refusal

from lerobot_robot.settings import Opening, Settings

ReturnT = TypeVar("ReturnT")

CLIPPED = 0.01  # rad or m between what was commanded and what LeRobot sent on
POSITION, VELOCITY = ".pos", ".vel"


@dataclass(frozen=True)
class Reading:
    """At a moment of this machine's clock [s]: positions, velocities where they are measured, opening [m].

    `seen` is the whole observation, by LeRobot's keys.
    """

    at_s: float
    q: tuple[float, ...]
    qd: "tuple[float, ...] | None"
    width_m: float
    seen: Mapping[str, Any]


def make_robot(fields: Mapping[str, Any], place: str) -> Robot:
    """The robot of a configuration, of LeRobot or of a plug-in that is installed; raises `SettingsError`."""
    with contextlib.redirect_stdout(sys.stderr):  # the first line of output is the endpoint
        return _make_robot(fields, place)


def _make_robot(fields: Mapping[str, Any], place: str) -> Robot:
    for package in (lerobot.robots, lerobot.cameras):
        for each in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            with contextlib.suppress(ImportError):  # of what is not installed
                __import__(each.name)
    register_third_party_plugins()
    known = RobotConfig.get_known_choices()
    if fields.get("type") not in known:
        raise SettingsError(f"{place}: robot.type", repr(fields.get("type")), f"one of {', '.join(sorted(known))}")
    try:
        return make_robot_from_config(draccus.decode(RobotConfig, dict(fields)))
    except Exception as error:  # a plug-in raises what it will
        found = " ".join(str(error).split())
        raise SettingsError(f"{place}: robot", found, f"a configuration of {fields['type']}") from error


class Device:
    """One robot, connected; raises `SettingsError` where it does not connect, is not calibrated or lacks a key."""

    def __init__(self, settings: Settings, robot: Robot) -> None:
        self._settings, self._robot = settings, robot
        joints = settings.lerobot.joints
        self._keys = [joints[name].key or name for name in settings.joints]
        self._maps = [(joints[name].zero, joints[name].scale) for name in settings.joints]
        observed, commanded = robot.observation_features, robot.action_features
        self._measures_speed = all(key + VELOCITY in observed for key in self._keys)
        self._wants_speed = [key + VELOCITY in commanded for key in self._keys]
        gripper = settings.lerobot.gripper
        self._hand: Opening | None = gripper.measured if gripper else None
        self._jaw: Opening | None = (gripper.commanded or gripper.measured) if gripper else None
        self._check_keys(observed, commanded)
        try:
            with contextlib.redirect_stdout(sys.stderr):
                asks = "calibrate" in inspect.signature(robot.connect).parameters
                robot.connect(**({"calibrate": False} if asks else {}))
        except Exception as error:  # a plug-in raises what it will
            found = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise SettingsError(f"{settings.place}: robot", found, "a robot that connects") from error
        if not robot.is_calibrated:
            self.close()
            expected = f"that of its motors; run `lerobot-calibrate --robot.type={settings.lerobot.robot['type']} …`"
            raise SettingsError(str(robot.calibration_fpath), "no calibration, or another one", expected)

    def _check_keys(self, observed: Mapping[str, Any], commanded: Mapping[str, Any]) -> None:
        """Whether the robot has each key of the file, and the file each action of the robot."""
        given, place = self._settings.lerobot, self._settings.place
        pictures = [key for each in given.cameras.values() for key in (each.color, each.depth) if key]
        positions = [key + POSITION for key in self._keys]
        sent = [*positions, *given.constants, *([self._jaw.key] if self._jaw else [])]
        sent += [key + VELOCITY for key, wants in zip(self._keys, self._wants_speed, strict=True) if wants]
        read = [*positions, *pictures, *([self._hand.key] if self._hand else [])]
        for keys, known, what in ((read, observed, "observations"), (sent, commanded, "actions")):
            if missing := [key for key in keys if key not in known]:
                raise SettingsError(place, f"{missing[0]!r}", f"one of its {what}: {', '.join(known)}")
        if left := [key for key in commanded if key not in sent]:
            raise SettingsError(f"{place}: constants", f"nothing for {', '.join(left)}", "a number for each action")

    def read(self) -> Reading:
        """The present; raises `Refusal` `TARGET_LOST`."""
        seen = self._call(self._robot.get_observation)
        at_s = time.monotonic()
        q = self._translate(seen, POSITION, [zero for zero, _ in self._maps])
        qd = self._translate(seen, VELOCITY, [0.0] * len(q)) if self._measures_speed else None
        width_m = 0.0
        if self._hand is not None:
            share = (_get(seen, self._hand.key) - self._hand.closed) / (self._hand.opened - self._hand.closed)
            width_m = min(max(share, 0.0), 1.0) * self._settings.width_max_m
        return Reading(at_s, q, qd, width_m, seen)

    def _translate(self, seen: Mapping[str, Any], ending: str, zeros: Sequence[float]) -> tuple[float, ...]:
        rows = zip(self._keys, zeros, self._maps, strict=True)
        return tuple((_get(seen, key + ending) - zero) / scale for key, zero, (_, scale) in rows)

    def send(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> bool:
        """One set-point; whether LeRobot sent it on as it was. Raises `Refusal` `TARGET_LOST`."""
        action = dict(self._settings.lerobot.constants)
        for key, (zero, scale), wants, at, speed in zip(self._keys, self._maps, self._wants_speed, q, qd, strict=True):
            action[key + POSITION] = zero + scale * at
            action |= {key + VELOCITY: scale * speed} if wants else {}
        if self._jaw is not None:
            share = width_m / self._settings.width_max_m
            action[self._jaw.key] = self._jaw.closed + share * (self._jaw.opened - self._jaw.closed)
        sent = self._call(lambda: self._robot.send_action(dict(action))) or action
        rows = zip(self._keys, self._maps, strict=True)
        return all(
            abs(sent[key + POSITION] - action[key + POSITION]) <= CLIPPED * abs(scale) for key, (_, scale) in rows
        )

    def close(self) -> None:
        """Disconnect; what that leaves of the drives is the plug-in's choice."""
        with contextlib.suppress(Refusal):
            self._call(self._robot.disconnect)

    def _call(self, act: "Callable[[], ReturnT]") -> "ReturnT":
        try:
            with contextlib.redirect_stdout(sys.stderr):
                return act()
        except Exception as error:  # a plug-in raises what it will
            found = f"{self._robot.name}: {type(error).__name__}: {' '.join(str(error).split())}"
            raise Refusal("TARGET_LOST", found) from error


def _get(seen: Mapping[str, Any], key: str) -> float:
    value = float(seen.get(key, math.nan))
    if not math.isfinite(value):
        raise Refusal("TARGET_LOST", f"{key}: {seen.get(key, 'nothing')} is no measurement")
    return value
