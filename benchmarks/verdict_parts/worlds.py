"""Worlds that went wrong, or right: made by physics from the state in which a recorded session left them.

Things are put somewhere and then left to gravity, contact and friction until they rest; nothing is judged here. This is
the generator of a benchmark and no episode, so it may put things where it wants.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.recorded import Robot
from benchmarks.verdict_parts.recordings import Recorded
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR

REST_S = 0.6  # things of a few centimetres come to rest within this
MORE_S = 0.3  # longer, a few times, while something still moves
STILL_M_S = 0.01
SPOT_X_M, SPOT_Y_M = (0.34, 0.62), (-0.28, 0.08)  # of the table, where every scene has room
SPOT_CLEARANCE_M = 0.075
OFF_TABLE_M = (-0.6, 0.9, -0.7)  # on the floor behind the robot, where no camera looks

Rng = np.random.Generator


@dataclass(slots=True)
class World:
    """One recorded session's world, to be changed and put back.

    Attributes:
        physics: Of the recorded scene and seed; its state is the one that is being made.
        recorded: Where it began.
    """

    physics: Physics
    recorded: Recorded

    @classmethod
    def open(cls, robot: Robot, recorded: Recorded) -> "World":
        """The world of a recording, as it was left."""
        scene = recorded.bundle.session.scene
        spec = read_scene(robot.library.get_scene(scene.name))
        world = cls(Physics.alone(robot.profile, robot.folder, spec, scene.seed), recorded)
        world.restore(recorded.after)
        return world

    @property
    def object(self) -> str:
        """What the session is about, a drawer too; the first cube where it is about nothing."""
        given = self.recorded.job.given
        first = next((name for name in self.movables if name.endswith("_cube")), self.movables[0])
        return str(given.get("object") or given.get("drawer") or first)

    @property
    def destination(self) -> str:
        """Where it should go, empty when nowhere."""
        given = self.recorded.job.given
        return str(given.get("destination") or given.get("support") or "")

    @property
    def movables(self) -> list[str]:
        """Free things, balls in a cup left out."""
        return [
            entity.name
            for entity in self.physics.scene.entities
            if entity.movable and entity.kind != "ball" and self._has_free_joint(entity.name)
        ]

    @property
    def others(self) -> list[str]:
        """Free things that the session is not about, and that nothing stands on."""
        named = {self.object, self.destination}
        return [name for name in self.movables if name not in named and not name.startswith("bottle")]

    def restore(self, state: np.ndarray) -> None:
        """Begin from a state."""
        self.physics.state.restore(state)
        mujoco.mj_forward(self.physics.model, self.physics.data)

    def find_initial(self, name: str) -> np.ndarray:
        """(7,) free pose of a thing before the session."""
        state = self.physics.state.read_state()
        self.restore(self.recorded.before)
        pose = self._pose_of(name).copy()
        self.restore(state)
        return pose

    def put(self, name: str, position_m: np.ndarray, yaw_rad: float = 0.0, tilt_rad: float = 0.0) -> None:
        """Put a free thing somewhere, at rest; what is in it goes along."""
        model, data = self.physics.model, self.physics.data
        pose = self._pose_of(name)
        contents = self._find_contents(name) if tilt_rad == 0.0 else []
        shift = np.asarray(position_m) - pose[:3]
        quaternion = np.zeros(4)
        mujoco.mju_euler2Quat(quaternion, np.array([tilt_rad, 0.0, yaw_rad]), "XYZ")
        pose[:3] = position_m
        if not contents:
            pose[3:] = quaternion
        for each in contents:
            self._pose_of(each)[:3] += shift
        for each in (name, *contents):
            dof = model.body(each).dofadr[0]
            data.qvel[dof : dof + 6] = 0.0
        mujoco.mj_forward(model, data)

    def push(self, name: str, velocity_m_s: np.ndarray) -> None:
        """Give a free thing a linear velocity (3,)."""
        dof = self.physics.model.body(name).dofadr[0]
        self.physics.data.qvel[dof : dof + 3] = velocity_m_s
        mujoco.mj_forward(self.physics.model, self.physics.data)

    def exchange(self, first: str, second: str) -> None:
        """Let two things change places, each at its own height above what the other stood on."""
        a, b = self._pose_of(first), self._pose_of(second)
        kept = a.copy()
        a[:], b[:] = b, kept
        for name in (first, second):
            dof = self.physics.model.body(name).dofadr[0]
            self.physics.data.qvel[dof : dof + 6] = 0.0
        mujoco.mj_forward(self.physics.model, self.physics.data)

    def set_fingers(self, width_m: float) -> None:
        """What the gripper is asked for from now on."""
        self.physics.data.actuator(GRIPPER_ACTUATOR).ctrl = width_m

    def set_opening(self, name: str, fraction: float) -> None:
        """Open what slides by a fraction of its travel."""
        joint = self.physics.model.body(name).jntadr[0]
        low, high = self.physics.model.jnt_range[joint]
        self.physics.data.qpos[self.physics.model.jnt_qposadr[joint]] = low + fraction * (high - low)
        mujoco.mj_forward(self.physics.model, self.physics.data)

    def settle(self, seconds: float = REST_S) -> None:
        """Let time pass until nothing moves, the arm being held where it is."""
        step_s = self.physics.model.opt.timestep
        self.physics.step(round(seconds / step_s))
        for _ in range(5):
            if all(self._find_speed(name) < STILL_M_S for name in self.movables):
                break
            self.physics.step(round(MORE_S / step_s))
        mujoco.mj_forward(self.physics.model, self.physics.data)

    def find_spot(self, rng: Rng, clearance_m: float = SPOT_CLEARANCE_M) -> np.ndarray:
        """(2,) a free spot of the table."""
        taken = [self.physics.data.body(name).xpos[:2] for name in self.movables]
        taken.append(self.physics.queries.find_tcp()[0][:2])
        for _ in range(200):
            spot = np.array([rng.uniform(*SPOT_X_M), rng.uniform(*SPOT_Y_M)])
            if all(np.linalg.norm(spot - other) > clearance_m for other in taken):
                return spot
        return np.array([0.3, -0.3])

    def find_half_height(self, name: str) -> float:
        """Of a thing, from its frame down to its lowest point when it stands [m]."""
        entity = next(each for each in self.physics.scene.entities if each.name == name)
        return max(shape.size_m[-1] - shape.pose.position_m[2] for shape in entity.shapes)

    def _find_contents(self, name: str) -> list[str]:
        data = self.physics.data
        inside = data.body(name).xpos
        balls = (entity.name for entity in self.physics.scene.entities if entity.kind == "ball")
        return [
            each
            for each in balls
            if np.linalg.norm(data.body(each).xpos[:2] - inside[:2]) < 0.03
            and data.body(each).xpos[2] > inside[2] - 0.1
        ]

    def _pose_of(self, name: str) -> np.ndarray:
        model, data = self.physics.model, self.physics.data
        address = int(model.jnt_qposadr[model.body(name).jntadr[0]])
        return data.qpos[address : address + 7]

    def _has_free_joint(self, name: str) -> bool:
        model = self.physics.model
        joint = int(model.body(name).jntadr[0])
        return joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE

    def _find_speed(self, name: str) -> float:
        model = self.physics.model
        dof = int(model.body(name).dofadr[0])
        return float(np.linalg.norm(self.physics.data.qvel[dof : dof + 3]))


Change = Callable[[World, Rng], None]
