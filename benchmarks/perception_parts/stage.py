"""A scene in a compiled model with cameras that look at it: what is there, and what is believed of it."""

import time
from collections.abc import Collection, Sequence

import mujoco
import numpy as np

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.scenes import Body, read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.pose_uncertainty import MAP_STDS
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.wire import Frames

LOOK_S = 0.2  # between two looks
OFF_M = 0.018  # of a body whose height the map has wrong
Array = np.ndarray


class World:
    """One scene, built with real contact physics and left to settle."""

    def __init__(self, library: Library, scene: str, seed: int) -> None:
        self.profile, self.folder = read_profile(library.get_target("panda"))
        self.name, self.seed = scene, seed
        self.spec = read_scene(library.get_scene(scene))
        self.physics = Physics.alone(self.profile, self.folder, self.spec, seed)
        self.physics.start(self.spec.settle_s)
        self.mask = RobotMask(self.profile, self.folder)
        self._settled = np.array(self.physics.data.qpos)

    def reset(self) -> None:
        """Everything where it settled."""
        self.physics.data.qpos[:] = self._settled

    def find(self, name: str) -> tuple[Array, Array]:
        """Position (3,) and rotation (3, 3) of a body, as they are."""
        self.physics.queries.look()
        body = self.physics.model.body(name).id
        return np.array(self.physics.queries.seen.xpos[body]), np.array(self.physics.queries.seen.xmat[body]).reshape(
            3, 3
        )

    def find_opening(self, name: str) -> float:
        """Opening of a body with a joint, as the joint says [m] or [rad]."""
        model = self.physics.model
        return float(self.physics.data.qpos[model.jnt_qposadr[model.body(name).jntadr[0]]])

    def put(self, name: str, x_m: float, y_m: float, yaw_rad: float = 0.0) -> None:
        """Set an object down somewhere."""
        model, data = self.physics.model, self.physics.data
        address = int(model.jnt_qposadr[model.body(name).jntadr[0]])
        data.qpos[address : address + 2] = x_m, y_m
        data.qpos[address + 3 : address + 7] = np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)

    def open_drawers(self, seed: int) -> None:
        """Slide every body with a joint of its own out by a part of its travel."""
        model, rng = self.physics.model, np.random.default_rng(seed)
        for name, body in self.spec.bodies.items():
            if body.joint is not None:
                address = model.jnt_qposadr[model.body(name).jntadr[0]]
                self.physics.data.qpos[address] = rng.uniform(0.0, body.joint.travel)


class Stage:
    """A world at one noise level, with a belief.

    Bodies of `unnamed` are not in the inventory. The map has those of `displaced` beside where they are, as far as it
    states, and the height of a third of them wrong.
    """

    def __init__(
        self,
        world: World,
        sensors: Sensors,
        level: str,
        unnamed: Collection[str] = (),
        prior: Prior = Prior.FULL,
        displaced: Collection[str] = (),
    ) -> None:
        self.world, self.displaced = world, displaced
        self._rng = np.random.default_rng(world.seed)
        self.noisy = sensors.get_noise(level).varies
        self.cameras = open_cameras(world.physics.model, sensors, seed=world.seed, level=level)
        bodies = {name: body for name, body in world.spec.bodies.items() if name not in unnamed}
        bodies |= {name: self._displace(bodies[name]) for name in displaced}
        inventory = build_inventory(world.spec.model_copy(update={"bodies": bodies}), prior)
        self.pipeline = Pipeline(inventory, world.mask, world.profile.target, noisy=self.noisy)
        self._scene = Scene(name=world.name, seed=world.seed, episode="bench")
        self.time_s: float = 1.0
        self.belief: Environment | None = None
        self.latest = Frames(())
        self.ms: list[float] = []
        world.physics.queries.look()
        self.state = world.physics.queries.read_target({})

    def _displace(self, body: Body) -> Body:
        off = self._rng.normal(0.0, MAP_STDS.repeat(3))
        off[2] += self._rng.choice([0.0, 0.0, self._rng.uniform(-OFF_M, OFF_M)])
        place = {"position_m": body.place.position_m + off[:3], "euler_rad": body.place.euler_rad + off[3:]}
        return body.model_copy(update={"place": body.place.model_copy(update={k: tuple(v) for k, v in place.items()})})

    def take_frames(self, cameras: Sequence[str] = ()) -> Frames:
        """What the cameras show, a while after the pictures before."""
        self.time_s += LOOK_S
        model: mujoco.MjModel = self.world.physics.model
        data = pose_state(model, self.world.physics.data.qpos)
        names = cameras or tuple(self.cameras)
        return Frames(tuple(self.cameras[name].capture(data, self.time_s, self._rng) for name in names))

    def look(self, cameras: Sequence[str] = ()) -> Environment:
        """One look, through all cameras or some."""
        return self.sense(self.take_frames(cameras))

    def sense(self, frames: Frames) -> Environment:
        """The belief after these frames."""
        self.latest, began_s = frames, time.perf_counter()
        self.belief = self.pipeline.sense(frames, self.state, self._scene, self.time_s, self.belief)
        self.ms.append(1e3 * (time.perf_counter() - began_s))
        return self.belief
