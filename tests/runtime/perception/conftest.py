"""A stage for perception: things on a table in a compiled model, cameras that look at them, hands that move them."""

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.world_model import WORLD, Need
from phyagentos.runtime.targets.wire import Frames, Step

SCENE = """
scene: test/twins
materials:
  wood: {rgba: [0.86, 0.68, 0.48, 1]}
  floor: {rgba: [0.82, 0.84, 0.87, 1]}
  red: {rgba: [0.82, 0.16, 0.14, 1]}
  blue: {rgba: [0.12, 0.33, 0.78, 1]}
  green: {rgba: [0.15, 0.6, 0.27, 1]}
bodies:
  table:
    kind: table
    fixed: true
    material: wood
    place: {position_m: [0.38, 0.05, -0.02]}
    shapes: [{kind: box, size_m: [0.52, 0.65, 0.02]}]
  floor:
    kind: floor
    fixed: true
    material: floor
    place: {position_m: [0.4, 0.0, -0.77]}
    shapes: [{kind: box, size_m: [3.0, 3.0, 0.02]}]
  first: &cube
    kind: cube
    color: red
    material: red
    place: {position_m: [0.48, -0.05, 0.0205], jitter_m: [0.001, 0.001, 0.0]}
    shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]
  second:
    <<: *cube
    place: {position_m: [0.48, 0.05, 0.0205], jitter_m: [0.001, 0.001, 0.0]}
  can:
    kind: can
    color: green
    material: green
    place: {position_m: [0.62, 0.0, 0.0405], jitter_m: [0.001, 0.001, 0.0]}
    shapes: [{kind: cylinder, size_m: [0.026, 0.04]}]
  screen:
    kind: screen
    color: blue
    material: blue
    place: {position_m: [0.3, 0.3, 0.0805], jitter_m: [0.001, 0.001, 0.0]}
    shapes: [{kind: box, size_m: [0.01, 0.1, 0.08]}]
cameras:
  top: {position_m: [0.5, 0.05, 1.6], target_m: [0.501, 0.051, 0.0], fovy_deg: 45}
lights:
  key: {position_m: [1.2, -1.2, 2.2], direction: [-0.4, 0.55, -1.0], diffuse: [0.65, 0.63, 0.6]}
"""
STATE = TargetState(q_rad=(0.0,) * 7, qd_rad_s=(0.0,) * 7, gripper_width_m=0.08, tcp=Pose((0.3, 0.0, 0.5)))


class Stage:
    """One scene, its cameras, and the belief about it.

    Attributes:
        belief: After the latest look.
    """

    def __init__(self, library, scene, seed=0, level="nominal"):
        profile, folder = read_profile(library.get_target("panda"))
        spec = read_scene(library.get_scene(scene))
        self.physics = Physics.alone(profile, folder, spec, seed)
        self.physics.start(spec.settle_s)
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        self.cameras = open_cameras(self.physics.model, sensors, seed=seed, level=level)
        self.pipeline = Pipeline(build_inventory(spec), RobotMask(profile, folder), "panda")
        self.scene = Scene(name=scene, seed=seed, episode="one")
        self.time_s, self.belief, self.looks = 1.0, None, 0
        self.physics.look()
        self.state = self.physics.read_target({})

    def put(self, name, x_m, y_m, z_m=None, yaw_rad=0.0, tilt_rad=0.0):
        """Set a thing down somewhere."""
        model, data = self.physics.model, self.physics.data
        address = int(model.jnt_qposadr[model.body(name).jntadr[0]])
        data.qpos[address : address + 2] = x_m, y_m
        if z_m is not None:
            data.qpos[address + 2] = z_m
        yaw, tilt = np.array([np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2)]), np.zeros(4)
        tilt[0], tilt[1] = np.cos(tilt_rad / 2), np.sin(tilt_rad / 2)
        w, z, (a, b) = yaw[0], yaw[3], tilt[:2]
        data.qpos[address + 3 : address + 7] = w * a, w * b, z * b, z * a

    def take_frames(self, cameras=()):
        """What the cameras show now."""
        data = pose_state(self.physics.model, self.physics.data.qpos)
        self.looks += 1
        names = cameras or self.cameras
        rngs = {name: np.random.default_rng((self.looks, index)) for index, name in enumerate(self.cameras)}
        return Frames(tuple(self.cameras[name].capture(data, self.time_s, rngs[name]) for name in names))

    def look(self, frames=None, state=None, after_s=0.5, cameras=()):
        """The belief half a second later."""
        self.time_s += after_s
        frames = frames or self.take_frames(cameras)
        state = state or self.state
        self.belief = self.pipeline.sense(frames, state, self.scene, self.time_s, self.belief)
        return self.belief

    def find(self, name):
        """(3,) where a thing really is."""
        self.physics.look()
        return np.array(self.physics.seen.xpos[self.physics.model.body(name).id])


def observe_now(world, stage, things=(), state=None):
    """What is perceived of a stage at its present time."""
    world._handle.latest = Step(time_s=stage.time_s, target=state or stage.state, tracking_error_rad=0.0)
    world.enter(stage.scene)
    return world.observe(Need(things=frozenset(things)) if things else WORLD)


def redate(frames, time_s):
    """The same pictures with another stamp."""
    return Frames(tuple(msgspec.structs.replace(frame, time_s=time_s) for frame in frames.frames))


@pytest.fixture(scope="module")
def twins_library(tmp_path_factory):
    root = tmp_path_factory.mktemp("project")
    (root / "scenes" / "test").mkdir(parents=True)
    (root / "scenes" / "test" / "twins.yaml").write_text(SCENE)
    return Library.open(root)


@pytest.fixture
def twins(twins_library):
    return Stage(twins_library, "test/twins")
