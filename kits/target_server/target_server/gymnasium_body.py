"""Any Gymnasium environment as a target: set-points become actions, what is observed becomes joints and objects.

    python -m target_server.gymnasium_body < KEY_AND_SETTINGS        # two lines: the key, the settings as JSON

Each row of set-points is one `env.step`. What the environment says of success and reward never goes over the wire: a
session is judged by evidence. Where `outcomes` names a file, it is written there after each session, for who measures.
"""

import importlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from target_server.body import Body, Entity, Joint, State, Triple
from target_server.server import main
from target_server.wire import Refusal

HALT_STEPS = 400


@dataclass(frozen=True)
class Motor:
    """How one joint is moved and measured.

    The action is set_point_gain q_d + gain (q_d - q) + velocity_gain qd_d, cut to the bounds of the action space; where
    it holds still, hold_gain is added to gain.

    Attributes:
        action: Its place in the action.
        observation: Place of its position in the observation; None where it is a dial, which stands where it was put.
        rest: Of a dial: where a halt puts it.
    """

    action: int
    low: float
    high: float
    observation: int | None = None
    set_point_gain: float = 0.0
    gain: float = 0.0
    velocity_gain: float = 0.0
    hold_gain: float = 0.0
    velocity: float = math.inf
    rest: float = 0.0
    axis: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Gripper:
    """A gripper by one number of the action and, where it is measured, one of the observation, each linear in width."""

    action: int
    opened: float
    closed: float
    width_m: float
    force_n: float
    observation: int | None = None
    observed_open: float = 1.0


@dataclass(frozen=True)
class SceneObject:
    """An entity: where it is stands at three places of the observation from `observation` on, or is fixed.

    Attributes:
        size_m: Half extents of its box [m].
        joint: Place of its joint in the observation, which reads `closed` to `opened`; None without one.
    """

    kind: str
    observation: int | None = None
    position_m: Triple = (0.0, 0.0, 0.0)
    size_m: Triple = (0.02, 0.02, 0.02)
    joint: int | None = None
    closed: float = 0.0
    opened: float = 1.0


@dataclass(frozen=True)
class Zone:
    """A region about a point of the observation.

    Attributes:
        observation: First of its three places.
        offset_m: From there to the middle of the region [m].
        half_m: Half extents [m].
    """

    observation: int
    offset_m: Triple = (0.0, 0.0, 0.0)
    half_m: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Settings:
    """A target made of an environment.

    Attributes:
        target: Its name in the framework.
        id: Of the environment, for `gymnasium.make`, with `kwargs`; `imports` are modules that register it.
        seed_argument: The argument of `gymnasium.make` that takes the scene's seed; without one `reset` takes it.
        scene_argument: The argument of `gymnasium.make` that takes the scene's name, for that in `kwargs`; without one
            all scenes are alike.
        signals: Name of an observation -> its first place in the environment's own, and the one behind its last.
        step_s: What one `env.step` takes [s]; so many in a command: `steps_per_command`.
        still: Slower than this a joint is at rest [1/s]; above what noise of the observation makes.
        tcp_m: (3,) the tool with all joints at zero [m].
        outcomes: File to which a line is appended after each session: `success` so far in the episode, `at_end` that of
            its last step, `completed` the environment's own list of completed parts, and `steps`.
    """

    target: str
    id: str
    joints: Mapping[str, Motor]
    step_s: float
    steps_per_command: int = 1
    kwargs: dict[str, Any] = field(default_factory=dict)
    imports: Sequence[str] = ()
    seed_argument: str = ""
    scene_argument: str = ""
    gripper: Gripper | None = None
    entities: Mapping[str, SceneObject] = field(default_factory=dict)
    regions: Mapping[str, Zone] = field(default_factory=dict)
    signals: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    still: float = 0.01
    tcp_m: Triple = (0.0, 0.0, 0.0)
    outcomes: str = ""


def make_settings(given: Mapping[str, Any]) -> Settings:
    """Settings from plain data; raises TypeError for a key that is not known or missing."""
    joints = {name: Motor(**each) for name, each in given["joints"].items()}
    objects = {name: SceneObject(**each) for name, each in given.get("entities", {}).items()}
    zones = {name: Zone(**each) for name, each in given.get("regions", {}).items()}
    gripper = Gripper(**given["gripper"]) if given.get("gripper") else None
    return Settings(**{**given, "joints": joints, "entities": objects, "regions": zones, "gripper": gripper})


class GymnasiumBody(Body):
    """One environment as a body."""

    has_truth = True
    actions = ("joint_position", "gripper_width")

    def __init__(self, settings: Settings) -> None:
        self._settings, self._motors = settings, tuple(settings.joints.values())
        self.target, self.driver = settings.target, settings.id
        self.step_s, self.steps_per_command, self.tcp_m = settings.step_s, settings.steps_per_command, settings.tcp_m
        self.joints = [
            Joint(name, each.low, each.high, each.velocity, each.axis) for name, each in settings.joints.items()
        ]
        self.observations = ("joint_state", "gripper_width", "entity_poses", "regions", *settings.signals)
        self.end_effector = "opening" if settings.gripper else "none"
        if settings.gripper is not None:
            self.gripper_force_n, self.width_max_m = settings.gripper.force_n, settings.gripper.width_m
        for module in settings.imports:
            importlib.import_module(module)
        self._env: Any = None
        self._made_for = ("", -1)
        self.load("", 0, b"")

    @property
    def time_s(self) -> float:
        return self._steps * self.step_s

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        if snapshot:
            raise Refusal("MALFORMED", "an environment goes on from no snapshot")
        asked = (scene if self._settings.scene_argument else "", seed if self._settings.seed_argument else 0)
        if asked != self._made_for or self._settings.seed_argument:
            self._make(*asked)
        self._steps, self._over, self._outcome = 0, "", {"success": False, "at_end": False, "completed": []}
        self._see(self._env.reset(seed=seed)[0])
        self._before = self._seen
        self._wanted = np.array([each.rest for each in self._motors])
        self._width_m = self._settings.gripper.width_m if self._settings.gripper else 0.0
        self._wanted = np.array(self._read_q())

    def read(self) -> State:
        q = self._read_q()
        speeds = (self._seen - self._before) / self.step_s
        qd = [0.0 if each.observation is None else float(speeds[each.observation]) for each in self._motors]
        tcp = np.array(self.tcp_m) + sum(x * np.array(each.axis) for x, each in zip(q, self._motors, strict=True))
        return State(q, qd, (float(tcp[0]), float(tcp[1]), float(tcp[2])), width_m=self._read_width())

    def list_entities(self) -> Sequence[Entity]:
        found = []
        for name, each in self._settings.entities.items():
            at = each.position_m if each.observation is None else self._seen[each.observation : each.observation + 3]
            shape = {"kind": "box", "size_m": each.size_m, "pose": {}}
            x, y, z = map(float, at)
            more = {} if each.joint is None else {"joint": self._measure_opening(each)}
            movable = each.observation is not None
            found.append(Entity(name, each.kind, (x, y, z), movable=movable, shapes=(shape,), more=more))
        return found

    def list_regions(self) -> Sequence[Mapping[str, Any]]:
        found = []
        for name, each in self._settings.regions.items():
            at = self._seen[each.observation : each.observation + 3] + each.offset_m
            found.append({"name": name, "pose": {"position_m": at.tolist()}, "half_m": each.half_m})
        return found

    def list_signals(self) -> Mapping[str, Sequence[float]]:
        return {name: self._seen[first:last].tolist() for name, (first, last) in self._settings.signals.items()}

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        self._wanted, self._width_m = np.array(q), width_m
        self._act(qd)
        return "TARGET_LIMIT" if self._over else ""

    def stay(self) -> None:
        self._act(np.zeros(len(self._motors)), is_held=True)

    def halt(self, category: int) -> None:
        dials = [
            each.rest if each.observation is None else x for x, each in zip(self._read_q(), self._motors, strict=True)
        ]
        self._wanted = np.array(dials)
        for _ in range(HALT_STEPS):
            self.stay()
            if max(map(abs, self.read().qd), default=0.0) < self._settings.still or self._over:
                return

    def note_end(self, session: str) -> None:
        if self._settings.outcomes:
            with Path(self._settings.outcomes).open("a", encoding="utf-8") as file:
                file.write(json.dumps({"session": session, **self._outcome, "steps": self._steps}) + "\n")

    def close(self) -> None:
        self._env.close()

    def _make(self, scene: str, seed: int) -> None:
        settings, self._made_for = self._settings, (scene, seed)
        more = settings.kwargs | ({settings.seed_argument: seed} if settings.seed_argument else {})
        more |= {settings.scene_argument: scene} if scene else {}
        if self._env is not None:
            self._env.close()
        self._env = gymnasium.make(settings.id, **more)
        space = self._env.action_space
        if isinstance(space, spaces.Discrete):
            self._low, self._high = np.array([space.start]), np.array([space.start + space.n - 1])
        elif isinstance(space, spaces.MultiDiscrete):
            self._low, self._high = np.zeros(space.nvec.size), space.nvec.ravel() - 1
        else:
            flat = spaces.flatten_space(space)
            if not isinstance(flat, spaces.Box):
                raise TypeError(f"an action space {space}; boxes, discrete ones and maps of boxes are possible")
            self._low, self._high = flat.low, flat.high

    def _act(self, qd: "Sequence[float] | NDArray[np.float64]", *, is_held: bool = False) -> None:
        """One step of the environment; an episode that is over stands still."""
        self._steps += 1
        self._before = self._seen
        if self._over:
            return
        settings, vector = self._settings, np.clip(np.zeros(len(self._low)), self._low, self._high)
        for each, q, wanted, speed in zip(self._motors, self._read_q(), self._wanted, qd, strict=True):
            gain = each.gain + each.hold_gain if is_held else each.gain
            towards = gain * (wanted - q) + each.velocity_gain * speed
            vector[each.action] = each.set_point_gain * wanted + towards
        if settings.gripper is not None:
            grip, share = settings.gripper, self._width_m / settings.gripper.width_m
            vector[grip.action] = grip.closed + share * (grip.opened - grip.closed)
        observed, _reward, terminated, truncated, info = self._env.step(self._compose(vector))
        self._note_success(info)
        self._over = "terminated" if terminated else "truncated" if truncated else ""
        self._see(observed)

    def _compose(self, vector: NDArray[np.float64]) -> Any:
        space, vector = self._env.action_space, np.clip(vector, self._low, self._high)
        if isinstance(space, spaces.Discrete):
            return int(np.rint(vector[0]))
        if isinstance(space, spaces.MultiDiscrete):
            return np.rint(vector).astype(space.dtype).reshape(space.shape)
        return spaces.unflatten(space, vector.astype(spaces.flatten_space(space).dtype))

    def _see(self, observed: Any) -> None:
        self._seen = np.asarray(spaces.flatten(self._env.observation_space, observed), dtype=np.float64)

    def _note_success(self, info: Mapping[str, Any]) -> None:
        is_met = bool(info.get("success", False))
        completed = [str(each) for each in info.get("episode_task_completions", ())]
        so_far = bool(self._outcome["success"]) or is_met
        self._outcome = {"success": so_far, "at_end": is_met, "completed": completed}

    def _measure_opening(self, item: SceneObject) -> float:
        assert item.joint is not None
        share = (float(self._seen[item.joint]) - item.closed) / (item.opened - item.closed)
        return min(max(share, 0.0), 1.0)

    def _read_q(self) -> list[float]:
        pairs = zip(self._motors, self._wanted, strict=True)
        return [float(was if each.observation is None else self._seen[each.observation]) for each, was in pairs]

    def _read_width(self) -> float:
        grip = self._settings.gripper
        if grip is None or grip.observation is None:
            return self._width_m
        return float(np.clip(self._seen[grip.observation] / grip.observed_open, 0.0, 1.0)) * grip.width_m


def make_body() -> GymnasiumBody:
    """As the settings on the second line of standard input say."""
    return GymnasiumBody(make_settings(json.loads(sys.stdin.readline())))


if __name__ == "__main__":
    main(make_body)
