"""CALVIN's arm as one target: set-points become its absolute joint actions, 30 Hz.

    python -m calvin_body < KEY_AND_SETTINGS      # two lines: the key, the settings as JSON

A seed is an official sequence and the number of an instruction in it: `5 * sequence + number`. Number 0 begins the
sequence in its initial state; the next one goes on from the present. Everything is in the frame of the robot's base,
whose x axis points across the table.

The oracles run in this process and never answer over the wire: at the end of each session what they found is appended
to the file `outcomes`, for who measures.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pybullet as p
from numpy.typing import NDArray
from target_server.body import Body, Entity, Joint, State
from target_server.mujoco_objects import to_quaternion
from target_server.wire import Refusal

from calvin_body.official import SCENE, SEQUENCES, Scorer, open_environment, read_instructions, read_start
from calvin_body.scene import Scene

Array = NDArray[np.float64]

STEP_S = 1.0 / 30.0
LENGTH = 5  # instructions of a sequence
WIDTH_M, FORCE_N = 0.08, 200.0
LAG_S = 1.0 / 240.0 / 0.1  # by which its position controllers are behind a steady motion: a step over their gain
OFFSET_RAD = np.array((np.pi / 2.0, *[0.0] * 6))  # CALVIN's joints where ours are zero, as our x axis is its y axis
STILL_RAD_S = 0.02
HALT_STEPS = 60
SETTLE_STEPS = 5
FLANGE = "panda_link7"
JAWS = (("panda_leftfinger", "finger_left_tip"), ("panda_rightfinger", "finger_right_tip"))


@dataclass(frozen=True)
class Settings:
    """A target made of CALVIN.

    Attributes:
        target: Its name in the framework.
        velocity_rad_s: (7,) greatest speeds of set-points.
        outcomes: File to which the success of each session is appended.
    """

    target: str
    velocity_rad_s: Sequence[float]
    outcomes: str


class CalvinBody(Body):
    """The robot of scene D."""

    driver = "calvin"
    step_s = STEP_S
    has_truth = True
    observations = ("joint_state", "gripper_width", "entity_poses")
    actions = ("joint_position", "gripper_width")
    end_effector = "opening"
    gripper_force_n, width_max_m = FORCE_N, WIDTH_M

    def __init__(self, settings: Settings) -> None:
        self._settings, self.target = settings, settings.target
        self._env = open_environment()
        self._robot, self._cid = self._env.robot, self._env.cid
        self._uid = self._robot.robot_uid
        self._base_m = np.array(self._robot.base_position)
        numbers = range(p.getNumJoints(self._uid, physicsClientId=self._cid))
        self._infos = [p.getJointInfo(self._uid, number, physicsClientId=self._cid) for number in numbers]
        self._links = {info[12].decode(): info[0] for info in self._infos}
        self._scene, self._scorer = Scene(self._env, self._base_m), Scorer(settings.outcomes)
        self._read_kinematics()
        self.tools = {"describe_scene": self._describe_scene}
        self._seed, self._steps = -1, 0
        self.load(SCENE, 0, b"")

    @property
    def time_s(self) -> float:
        return self._steps * STEP_S

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        if snapshot:
            raise Refusal("MALFORMED", "an episode goes on from no snapshot")
        sequence, number = divmod(seed, LENGTH)
        if scene != SCENE or not 0 <= sequence < SEQUENCES:
            raise Refusal("MALFORMED", f"scene {scene!r}, seed {seed}; {SCENE}, and a seed below {LENGTH * SEQUENCES}")
        if number and self._seed not in (seed, seed - 1):
            raise Refusal("MALFORMED", f"seed {seed} goes on from {seed - 1}; the present one is {self._seed}")
        if not number:
            robot, objects = read_start(sequence)
            self._env.reset(robot_obs=robot, scene_obs=objects)
            self._steps, self._action, self._width_m = 0, 1, WIDTH_M
            self._rest()
            for _ in range(SETTLE_STEPS):
                self._act(np.zeros(len(self.joints)), scores=False)
        if not number or seed != self._seed:
            self._scorer.begin(sequence, number, self._env.get_info())
        self._seed = seed

    def read(self) -> State:
        q, qd = self._read_arm()
        position_m, rotation = self._locate("tcp")
        x, y, z = position_m.tolist()
        w, i, j, k = to_quaternion(rotation)
        touched = self._list_touched()
        return State(
            q=q.tolist(),
            qd=qd.tolist(),
            tcp_m=(x, y, z),
            tcp_wxyz=(w, i, j, k),
            width_m=self._measure_width(),
            holding=tuple(sorted(touched[0] & touched[1])),
            fingers_touching=sum(map(bool, touched)),
        )

    def list_entities(self) -> Sequence[Entity]:
        touched = self._list_touched()
        return self._scene.list_entities(self.target, sorted(touched[0] & touched[1]))

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        self._wanted, self._width_m = np.array(q), width_m
        self._act(np.array(qd))
        return ""

    def stay(self) -> None:
        self._act(np.zeros(len(self.joints)))

    def halt(self, category: int) -> None:
        self._rest()
        for _ in range(HALT_STEPS):
            self.stay()
            if np.abs(self._read_arm()[1]).max() < STILL_RAD_S:
                break
        self._rest()

    def note_end(self, session: str) -> None:
        self._scorer.note(session)

    def close(self) -> None:
        self._env.close()

    def _rest(self) -> None:
        self._wanted, _ = self._read_arm()

    def _read_arm(self) -> tuple[Array, Array]:
        """Positions and velocities (7,) of its joints."""
        states = p.getJointStates(self._uid, self._robot.arm_joint_ids, physicsClientId=self._cid)
        q, qd, *_ = zip(*states, strict=True)
        return np.array(q) - OFFSET_RAD, np.array(qd)

    def _measure_width(self) -> float:
        states = p.getJointStates(self._uid, self._robot.gripper_joint_ids, physicsClientId=self._cid)
        return min(max(sum(float(each[0]) for each in states), 0.0), WIDTH_M)

    def _list_touched(self) -> list[set[str]]:
        return [self._scene.list_touched(self._uid, [self._links[name] for name in jaw]) for jaw in JAWS]

    def _act(self, qd: Array, *, scores: bool = True) -> None:
        """One action towards the wanted set-points, ahead by what the controllers lag behind."""
        if abs(self._width_m - self._measure_width()) > WIDTH_M / 40.0:
            self._action = 1 if self._width_m > self._measure_width() else -1
        action = np.array([*(self._wanted + LAG_S * qd + OFFSET_RAD), self._action])
        *_, info = self._env.step({"type": "joint_abs", "action": action})
        self._steps += 1
        if scores:
            self._scorer.look(info)

    def _locate(self, link: str) -> tuple[Array, Array]:
        return self._scene.locate((self._uid, self._links[link]))

    def _read_kinematics(self) -> None:
        """Joints, and where the tool is, with all joints at zero."""
        arm = self._robot.arm_joint_ids
        for number in arm:
            p.resetJointState(self._uid, number, OFFSET_RAD[number], physicsClientId=self._cid)
        self.joints = []
        ends = np.maximum(self._robot.ll_real, self._robot.ll_real - OFFSET_RAD), self._robot.ul_real - OFFSET_RAD
        limits = zip(arm, *ends, self._settings.velocity_rad_s, strict=True)
        for number, low, high, velocity in limits:
            info = self._infos[number]
            position_m, rotation = self._locate(info[12].decode())
            axis, anchor = tuple((rotation @ info[13]).tolist()), tuple(position_m.tolist())
            name = info[1].decode().removeprefix("panda_")
            self.joints.append(Joint(name, float(low), float(high), velocity, axis, anchor, slides=False))
        tool_m, flange_m = self._locate("tcp")[0], self._locate(FLANGE)[0]
        self.tcp_m, self._flange_to_tool_m = tuple(tool_m.tolist()), float(np.linalg.norm(tool_m - flange_m))

    def _describe_scene(self, arguments: Mapping[str, Any]) -> dict[str, tuple[str, bytes]]:
        """The instructions of `sequences`, and every object with its geometry as each begins."""
        ranges_rad = {each.name: (each.low, each.high) for each in self.joints}
        tool = {"flange_to_tool_m": self._flange_to_tool_m, "ranges_rad": ranges_rad}
        told: dict[str, Any] = {"tool": tool, "sequences": {}}
        for sequence in arguments["sequences"]:
            self.load(SCENE, LENGTH * int(sequence), b"")
            entities = [each.encode() for each in self.list_entities()]
            told["sequences"][str(sequence)] = {"instructions": read_instructions(sequence), "entities": entities}
        return {"scene.json": ("application/json", json.dumps(told).encode())}


def make_body() -> CalvinBody:
    """As the settings on the second line of standard input say."""
    return CalvinBody(Settings(**json.loads(sys.stdin.readline())))
