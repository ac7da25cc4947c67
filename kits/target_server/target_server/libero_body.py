"""LIBERO's tasks as one target: set-points become actions of its operational-space controller (OSC_POSE), 20 Hz.

    python -m target_server.libero_body < KEY_AND_SETTINGS      # two lines: the key, the settings as JSON

A scene is `SUITE/NUMBER` and a seed the number of an official initial state. The controller follows the pose of the
hand, so a row of joint positions becomes the pose to which they bring it; what the arm's seventh joint is free to do is
the controller's own. Everything is told in the frame of the robot's base.

What the benchmark says of success never goes over the wire. Where `outcomes` names a file, it is appended there at the
end of each session, for who measures.
"""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from libero.libero import benchmark
from libero.libero.envs.env_wrapper import ControlEnv
from numpy.typing import NDArray

from target_server.body import Body, Entity, Joint, Picture, State, Window
from target_server.mujoco_cameras import VISIBLE_GROUPS, Cameras, Sensor
from target_server.mujoco_objects import Joint as JointOfObject
from target_server.mujoco_objects import (
    Mark,
    SceneObject,
    Solid,
    cover_seen,
    list_objects,
    narrow_turned,
    to_quaternion,
)
from target_server.server import main
from target_server.wire import Refusal

Array = NDArray[np.float64]

STEP_S = 0.05
WIDTH_M = 0.08
GRIP_STEP_M = 0.01  # of the opening in one step
FORCE_N = 20.0  # of a finger: its motor's limit
SQUEEZE_M = 0.04  # of the opening, at which both motors reach it
SETTLE_STEPS = 10  # after an initial state is set, as the benchmark's own evaluation does
# Where fixtures stand is drawn at each reset, and no part of an initial state; its evaluation draws with 0.
FIXTURES_SEED = 0
SHARES = 2001  # of a travel at which it is asked whether that is open
LAG_S = 2.0 / np.sqrt(150.0)  # by which the controller is behind a steady motion: damping over stiffness
MOST_M, MOST_RAD = 0.05, 0.5  # an action of 1
LEVER_M = 0.5  # a tool that is so far off is off as by one radian of an arm
STILL_RAD_S = 0.02
HALT_STEPS = 60
STAND = "mount0"
WRIST, HAND = "robot0_link6", "gripper0"
ROBOT = ("robot0", HAND, STAND)
ARM = tuple(f"robot0_joint{number}" for number in range(1, 8))
FINGERS = ("gripper0_finger_joint1", "gripper0_finger_joint2")
JAWS = (("gripper0_leftfinger", "gripper0_finger_joint1_tip"), ("gripper0_rightfinger", "gripper0_finger_joint2_tip"))
SITE, PADS, FLANGE = "gripper0_grip_site", "gripper0_finger1_pad_collision", "robot0_link7"
BASE = "robot0_link0"
CAMERAS = {
    "agentview": Sensor("agentview", 384, 384, (0.3, 1.7)),
    "eye_in_hand": Sensor("robot0_eye_in_hand", 384, 384, (0.06, 1.5)),
}
"""Its own cameras, where they are and as wide as they look; pixels and ranges of depth are chosen here."""
TOOL = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))  # in the site's frame: z approaches, y closes


@dataclass(frozen=True)
class Settings:
    """A target made of LIBERO.

    Attributes:
        target: Its name in the framework.
        scene: The one that is loaded first: `SUITE/NUMBER`.
        velocity_rad_s: (7,) greatest speeds of set-points.
        outcomes: File to which the success of each session is appended.
        draws: Whether its cameras will be asked for pictures: the graphics are opened with each scene then.
    """

    target: str
    scene: str
    velocity_rad_s: Sequence[float]
    outcomes: str = ""
    draws: bool = False


@dataclass(frozen=True)
class Arm:
    """Where a state of the simulation has the arm: views, which follow it.

    Attributes:
        q: (7,) joint positions [rad], `qd` velocities [rad/s], `fingers_m` (2,) positions of both fingers [m].
        site_m: (3,) the controller's site in the world [m]; `site` (3, 3) its rotation.
    """

    q: Array
    qd: Array
    fingers_m: Array
    site_m: Array
    site: Array


class LiberoBody(Body):
    """The robot of the task that is loaded."""

    driver = "libero"
    step_s = STEP_S
    has_truth = True
    cameras = tuple(CAMERAS)
    observations = ("joint_state", "gripper_width", "entity_poses")
    actions = ("joint_position", "gripper_width")
    end_effector = "opening"
    gripper_force_n, width_max_m = FORCE_N, WIDTH_M

    def __init__(self, settings: Settings) -> None:
        self._settings, self.target = settings, settings.target
        self._scene, self._steps, self._state = "", 0, 0
        self._env: Any = None
        self._present: tuple[State, Array, Array] | None = None  # until the next step; with the pose of the tool
        self._row: Sequence[float] | None = None  # the set-points of the latest step, and where they bring the tool
        self.tools = {"describe_scene": self._describe_scene}
        self.load(settings.scene, 0, b"")

    @property
    def time_s(self) -> float:
        return self._steps * STEP_S

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        if snapshot:
            raise Refusal("MALFORMED", "an episode goes on from no snapshot")
        self._open(scene)
        if not 0 <= seed < len(self._states):
            raise Refusal("MALFORMED", f"seed {seed}; {scene} has the initial states 0 to {len(self._states) - 1}")
        self._steps, self._reached, self._state, self._present = 0, False, seed, None
        self._env.seed(FIXTURES_SEED)
        self._env.reset()
        self._env.set_init_state(self._states[seed])
        self._data = self._env.sim.data._data
        self._arm = self._view_arm(self._data)
        for _ in range(SETTLE_STEPS):
            self._env.step([0.0] * 6 + [-1.0])
        self._width_m = WIDTH_M
        self._rest()
        if self._settings.draws:
            self.capture((), {}, 1)

    def read(self) -> State:
        return self._look()[0]

    def measure_error(self, wanted: Sequence[float]) -> float:
        _, position_m, rotation = self._look()
        aim_m, aim = self._aim if wanted is self._row else self._compute_tool(np.asarray(wanted))
        off_m, off_rad = aim_m - position_m, _to_vector(aim.dot(rotation.T))
        return max(math.sqrt(off_m.dot(off_m)) / LEVER_M, math.sqrt(off_rad.dot(off_rad)))

    def list_entities(self) -> Sequence[Entity]:
        held = self._list_held(self._list_touched())
        return [self._read_entity(each, held) for each in self._objects]

    def list_regions(self) -> Sequence[Mapping[str, Any]]:
        return [self._place(item, mark) for item in self._objects for mark in item.regions]

    def capture(self, cameras: Sequence[str], windows: Mapping[str, Window], every: int) -> Sequence[Picture]:
        return self._cameras.capture(self._data, self.time_s, cameras, windows, every)

    def step(self, q: Sequence[float], qd: Sequence[float], width_m: float) -> str:
        self._wanted, self._row, self._width_m = np.array(q), q, width_m
        self._aim = self._compute_tool(self._wanted)
        self._act(np.asarray(qd))
        return ""

    def stay(self) -> None:
        self._act(np.zeros(len(ARM)))

    def halt(self, category: int) -> None:
        self._wanted = self._arm.q.copy()
        for _ in range(HALT_STEPS):
            self.stay()
            if np.abs(self._arm.qd).max() < STILL_RAD_S:
                break
        self._rest()

    def note_end(self, session: str) -> None:
        if self._settings.outcomes:
            line = {"session": session, "scene": self._scene, "state": self._state, "steps": self._steps}
            line |= {"success": bool(self._env.check_success()), "reached": self._reached}
            with Path(self._settings.outcomes).open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")

    def close(self) -> None:
        if self._env is not None:
            self._cameras.close()
            self._env.close()

    def _open(self, scene: str) -> None:
        """Build the environment of a scene, unless it is the present one."""
        if scene == self._scene:
            return
        suite, _, number = scene.partition("/")
        suites = benchmark.get_benchmark_dict()
        if suite not in suites or not number.isdecimal():
            raise Refusal("MALFORMED", f"no scene {scene!r}; SUITE/NUMBER of {', '.join(suites)}")
        tasks = suites[suite]()
        if int(number) >= tasks.n_tasks:
            raise Refusal("MALFORMED", f"no scene {scene!r}; {suite} has the tasks 0 to {tasks.n_tasks - 1}")
        self.close()
        self._bddl = Path(tasks.get_task_bddl_file_path(int(number)))
        self._env = ControlEnv(
            bddl_file_name=str(self._bddl), use_camera_obs=False, has_renderer=False, has_offscreen_renderer=False,
            hard_reset=False, ignore_done=True,
        )  # fmt: skip
        self._env.reset()
        self.build_observations(False)
        self._scene, self._states = scene, tasks.get_task_init_states(int(number))
        self._task = tasks.get_task(int(number)).language
        self._read_model()

    def build_observations(self, builds: bool) -> None:
        """Whether a step builds the environment's own observations: 4 to 8 % of its time, and not read here."""
        for name in self._env.env.observation_names:
            self._env.env.modify_observable(name, "enabled", builds)

    def _look(self) -> tuple[State, Array, Array]:
        """The present, which stays until the next step, and where the tool is as `_read_tool` has it."""
        if self._present is None:
            position_m, rotation = self._read_tool(self._arm)
            x, y, z = position_m.tolist()
            w, i, j, k = to_quaternion(rotation)
            left_m, right_m = self._arm.fingers_m.tolist()
            touched = self._list_touched()
            state = State(
                q=self._arm.q.tolist(),
                qd=self._arm.qd.tolist(),
                tcp_m=(x, y, z),
                tcp_wxyz=(w, i, j, k),
                width_m=min(abs(left_m) + abs(right_m), WIDTH_M),
                holding=self._list_held(touched),
                fingers_touching=sum(map(bool, touched)),
            )
            self._present = state, position_m, rotation
        return self._present

    def _read_model(self) -> None:
        """What stays as it is while this environment is open."""
        inner, model, data = self._env.env, self._env.sim.model._model, self._env.sim.data._data
        self._model, self._scratch = model, mujoco.MjData(model)
        self._q_at, self._fingers_at = (
            _find_slice(model.joint(name).qposadr for name in each) for each in (ARM, FINGERS)
        )
        self._qd_at = _find_slice(model.joint(name).dofadr for name in ARM)
        self._opening = np.sign([model.joint(name).range.sum() for name in FINGERS])  # a finger closes towards zero
        self._base_m, self._base = data.body(BASE).xpos.copy(), data.body(BASE).xmat.reshape(3, 3).copy()
        self._cameras = Cameras(model, CAMERAS, self._base_m, self._base)
        self._grip = data.site(SITE).id
        self._there = self._view_arm(self._scratch)
        self._tip_m = self._measure_tip()
        jaws = [{data.body(name).id for name in names} for names in JAWS]
        owners = model.geom_bodyid.tolist()
        self._jaws = [frozenset(geom for geom, body in enumerate(owners) if body in jaw) for jaw in jaws]  # their geoms
        self._both_jaws = self._jaws[0] | self._jaws[1]
        roots = {int(number): name for name, number in inner.obj_body_id.items()}
        kinds = {
            name: each.category_name
            for name, each in {**inner.objects_dict, **inner.fixtures_dict}.items()
            if hasattr(each, "category_name")
        }
        self._objects = list_objects(model, data, roots, kinds, frozenset(inner.object_sites_dict), ROBOT)
        made = {**inner.objects_dict, **inner.fixtures_dict}
        self._ends = {each.name: find_ends(each.joint, made[each.owner]) for each in self._objects if each.joint}
        low, high = zip(*(model.joint(name).range for name in ARM), strict=True)
        self.joints = [
            Joint(name.removeprefix("robot0_"), float(a), float(b), velocity, axis, anchor_m, slides=False)
            for name, a, b, velocity, (axis, anchor_m) in zip(
                ARM, low, high, self._settings.velocity_rad_s, self._measure_axes(), strict=True
            )
        ]  # fmt: skip
        self.tcp_m = tuple(self._compute_tool(np.zeros(len(ARM)))[0].tolist())

    def _measure_tip(self) -> Array:
        """(3,) from the controller's site to the middle between the pads, in the site's frame."""
        mujoco.mj_kinematics(self._model, self._scratch)
        site, pad = self._scratch.site(SITE), self._scratch.geom(PADS)
        along_m = float((pad.xpos - site.xpos) @ site.xmat.reshape(3, 3)[:, 2])
        return np.array((0.0, 0.0, along_m))

    def _measure_axes(self) -> list[tuple[Any, Any]]:
        """Axis and anchor of each joint with all joints at zero."""
        self._scratch.qpos[self._q_at] = 0.0
        mujoco.mj_kinematics(self._model, self._scratch)
        joints = [self._scratch.joint(name) for name in ARM]
        return [
            (
                tuple((self._base.T @ each.xaxis).tolist()),
                tuple((self._base.T @ (each.xanchor - self._base_m)).tolist()),
            )
            for each in joints
        ]

    def _view_arm(self, data: Any) -> Arm:
        site_m, site = data.site_xpos[self._grip], data.site_xmat[self._grip].reshape(3, 3)
        return Arm(data.qpos[self._q_at], data.qvel[self._qd_at], data.qpos[self._fingers_at], site_m, site)

    def _read_tool(self, arm: Arm) -> tuple[Array, Array]:
        """Tool centre point (3,), midway between the pads, and its rotation (3, 3)."""
        rotation = self._base.T.dot(arm.site)
        position_m = self._base.T.dot(arm.site_m - self._base_m) + rotation.dot(self._tip_m)
        return position_m, rotation.dot(TOOL)

    def _compute_tool(self, q: Array) -> tuple[Array, Array]:
        """Where joint positions (7,) bring the tool."""
        self._there.q[:] = q
        mujoco.mj_kinematics(self._model, self._scratch)
        return self._read_tool(self._there)

    def _act(self, qd: Array) -> None:
        """One step towards the wanted set-points, ahead by what the controller lags behind."""
        aim_m, aim = self._compute_tool(self._wanted + LAG_S * qd)
        _, position_m, rotation = self._look()
        site_m = (aim_m - position_m) + (rotation - aim).dot(self._tip_m)  # the site lies on the approach axis
        turned_rad = _to_vector(aim.dot(rotation.T))
        moves = (self._base.dot(site_m) / MOST_M).tolist() + (self._base.dot(turned_rad) / MOST_RAD).tolist()
        action = np.array([*(min(max(each, -1.0), 1.0) for each in moves), self._choose_grip()])
        self._present = None
        *_, is_met, _ = self._env.step(action)  # says whether the benchmark's goal is met
        self._steps += 1
        self._reached = self._reached or bool(is_met)

    def _choose_grip(self) -> float:
        """1 closes, -1 opens, by a fixed step of the opening that the motors have as their aim; 0 leaves it.

        Their aim is not brought further into an object than their full force needs, so that they let go at once.
        """
        aim_m = WIDTH_M * (1.0 + float(self._env.env.robots[0].gripper.current_action[0])) / 2.0
        wanted_m = max(self._width_m, self.read().width_m - SQUEEZE_M)
        if abs(wanted_m - aim_m) < GRIP_STEP_M / 2.0:
            return 0.0
        return 1.0 if wanted_m < aim_m else -1.0

    def _rest(self) -> None:
        self._wanted = self._arm.q.copy()

    def _list_held(self, touched: Sequence[set[int]]) -> tuple[str, ...]:
        """What moves and is touched by both jaws."""
        if not all(touched):
            return ()
        return tuple(
            each.name
            for each in self._objects
            if each.movable and all(not geoms.isdisjoint(each.geoms) for geoms in touched)
        )

    def _list_touched(self) -> tuple[set[int], ...]:
        """The geoms that each jaw touches, but for the other jaw's."""
        pairs, jaws = self._data.contact.geom, self._both_jaws
        touched: tuple[set[int], ...] = tuple(set() for _ in JAWS)
        if jaws.isdisjoint(pairs.ravel().tolist()):
            return touched
        for one, other in (*pairs.tolist(), *pairs[:, ::-1].tolist()):
            for jaw, objects in zip(self._jaws, touched, strict=True):
                if one in jaw and other not in jaws:
                    objects.add(other)
        return touched

    def _locate(self, item: SceneObject) -> tuple[Array, Array]:
        """Position (3,) and rotation (3, 3) of an object."""
        position_m = self._base.T @ (self._data.xpos[item.body] - self._base_m)
        return position_m, self._base.T @ self._data.xmat[item.body].reshape(3, 3)

    def _read_entity(self, item: SceneObject, held: Sequence[str]) -> Entity:
        position_m, rotation = self._locate(item)
        more: dict[str, Any] = {}
        if item.movable:
            more["speed_m_s"] = float(np.linalg.norm(self._data.cvel[item.body][3:]))
        if item.name == item.owner:
            more["datum_m"] = (0.0, 0.0, 0.0)
        if item.name in held:
            more["held_by"] = self.target
        if (room := item.interior) is not None:
            half_m = np.abs(room.rotation) @ narrow_turned(room.half_m, rotation @ room.rotation)
            more["interior"] = {"center_m": room.center_m.tolist(), "half_m": half_m.tolist()}
        if (joint := item.joint) is not None:
            share = (float(self._data.qpos[joint.address]) - joint.closed) / (joint.opened - joint.closed)
            more["joint"] = min(max(share, 0.0), 1.0)
            more["mechanism"] = {
                "kind": joint.kind, "axis": joint.axis.tolist(), "travel": joint.travel,
                "anchor_m": joint.anchor_m.tolist(), "closed": self._place_closed(item), **self._ends[item.name],
            }  # fmt: skip
        if item.part_of:
            more["part_of"] = item.part_of
        x, y, z = position_m.tolist()
        a, b, c, d = to_quaternion(rotation)
        shapes = [each.encode() for each in item.solids]
        return Entity(item.name, item.kind, (x, y, z), (a, b, c, d), item.movable, shapes, more)

    def _place_closed(self, item: SceneObject) -> dict[str, Any]:
        """Pose of what has a joint when it is closed."""
        joint = item.joint
        assert joint is not None
        self._scratch.qpos[:] = self._data.qpos
        self._scratch.qpos[joint.address] = joint.closed
        mujoco.mj_kinematics(self._model, self._scratch)
        position_m = self._base.T @ (self._scratch.xpos[item.body] - self._base_m)
        rotation = self._base.T @ self._scratch.xmat[item.body].reshape(3, 3)
        return {"position_m": position_m.tolist(), "quaternion_wxyz": to_quaternion(rotation)}

    def _place(self, item: SceneObject, mark: Mark) -> dict[str, Any]:
        position_m, rotation = self._locate(item)
        turned = rotation @ mark.rotation
        pose = {
            "position_m": (position_m + rotation @ mark.center_m).tolist(),
            "quaternion_wxyz": to_quaternion(turned),
        }
        return {"name": mark.name, "pose": pose, "half_m": narrow_turned(mark.half_m, turned).tolist()}

    def _describe_scene(self, arguments: Mapping[str, Any]) -> dict[str, tuple[str, bytes]]:
        """The task in its own words, and every object with its geometry."""
        self._open(str(arguments.get("scene") or self._scene))
        self.load(self._scene, int(arguments.get("seed", 0)), b"")
        marks = [(item, mark) for item in self._objects for mark in item.marks]
        told = {
            "language": self._task,
            "goal": self._bddl.read_text(encoding="utf-8"),
            "states": len(self._states),
            "entities": [each.encode() for each in self.list_entities()],
            "regions": self.list_regions(),
            "owners": {each.name: each.owner for each in self._objects},
            "marks": {mark.name: self._describe_mark(item, mark) for item, mark in marks},
            "tool": self._describe_tool(),
        }
        if arguments.get("looks"):
            shown = [each for each in self._objects if each.bodies and each.movable]
            told["looks"] = {each.name: self._photograph(each) for each in shown}
            told["covers"] = {
                each.name: [solid.encode() for solid in cover_seen(self._model, self._data, each, VISIBLE_GROUPS[0])]
                for each in shown
            }
            told["stand"], told["wrist"] = self._describe_body(STAND), self._describe_body(WRIST)
            told["hand"] = self._describe_body(HAND)
        return {"scene.json": ("application/json", json.dumps(told).encode())}

    def _describe_mark(self, item: SceneObject, mark: Mark) -> dict[str, Any]:
        """Where it is in the frame of its object."""
        turned = self._locate(item)[1] @ mark.rotation
        half_m = np.abs(mark.rotation) @ narrow_turned(mark.half_m, turned)
        place = {"center_m": mark.center_m.tolist(), "half_m": half_m.tolist()}
        return {"entity": item.name, "is_surface": mark.is_surface, **place}

    def _photograph(self, item: SceneObject) -> list[list[list[float]]]:
        """The colours of an object, of pictures that are taken of it beforehand."""
        geoms = [geom for body in item.bodies for geom in self._list_geoms(body)]
        corners_m = np.concatenate([solid.corners_m for solid in item.solids])
        low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
        turn = self._data.xmat[item.body].reshape(3, 3)
        center_m = self._data.xpos[item.body] + turn @ ((low_m + high_m) / 2.0)
        return self._cameras.photograph(self._data, geoms, center_m, float(np.linalg.norm(high_m - low_m)) / 2.0)

    def _describe_body(self, prefix: str) -> list[dict[str, Any]]:
        """Boxes around each part of the robot whose name begins so, with all joints at zero and the fingers apart."""
        self._scratch.qpos[self._fingers_at] = self._opening * WIDTH_M / 2.0
        self._compute_tool(np.zeros(len(ARM)))
        bodies = [number for number in range(self._model.nbody) if self._model.body(number).name.startswith(prefix)]
        shapes = []
        for geom in (geom for body in bodies for geom in self._list_geoms(body)):
            turn = self._base.T @ self._scratch.geom_xmat[geom].reshape(3, 3)
            middle_m = self._base.T @ (self._scratch.geom_xpos[geom] - self._base_m)
            half_m = self._model.geom_aabb[geom][3:]
            shapes.append(
                Solid("box", half_m, middle_m + turn @ self._model.geom_aabb[geom][:3], turn, half_m).encode()
            )
        return shapes

    def _list_geoms(self, body: int) -> range:
        first = int(self._model.body_geomadr[body])
        return range(first, first + int(self._model.body_geomnum[body]))

    def _describe_tool(self) -> dict[str, float]:
        """How far the tool centre point and the tips of the pads are from the flange [m]."""
        self._compute_tool(np.zeros(len(ARM)))
        tool_m, _ = self._read_tool(self._there)
        flange_m = self._base.T @ (self._scratch.body(FLANGE).xpos - self._base_m)
        return {
            "flange_to_tool_m": float(np.linalg.norm(tool_m - flange_m)),
            "tip_m": float(self._model.geom(PADS).size[2]),
        }


def find_ends(joint: JointOfObject, made: Any) -> dict[str, float]:
    """The shares of its travel from which a joint counts as open, and up to which as closed, as its object says."""
    shares = np.linspace(0.0, 1.0, SHARES)
    ends: dict[str, float] = {}
    for names, key, at in ((("is_open", "turn_on"), "opens_at", max), (("is_close", "turn_off"), "closes_at", min)):
        for name in names:
            try:
                holds = [getattr(made, name)(joint.closed + share * (joint.opened - joint.closed)) for share in shares]
            except (AttributeError, NotImplementedError):
                continue
            if True in holds and False in holds:
                at_share = shares[holds.index(True)] if at is max else shares[holds.index(False) - 1]
                ends[key] = float(at_share)
    return ends


def _find_slice(addresses: Iterable[Array]) -> slice:
    """Of joints one after the other."""
    first, *_, last = (int(each[0]) for each in addresses)
    return slice(first, last + 1)


def _to_vector(rotation: Array) -> Array:
    """(3,) axis times angle [rad] of a rotation (3, 3)."""
    found, quaternion = np.empty(3), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    mujoco.mju_quat2Vel(found, quaternion, 1.0)
    return found


def make_body() -> LiberoBody:
    """As the settings on the second line of standard input say."""
    return LiberoBody(Settings(**json.loads(sys.stdin.readline())))


if __name__ == "__main__":
    main(make_body)
