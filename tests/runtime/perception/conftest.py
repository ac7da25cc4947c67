"""A stage for perception: things on a table in a compiled model, cameras that look at them, hands that move them."""

import msgspec
import numpy as np
import pytest

from benchmarks.worlds.table import TOP, render_table
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

FLOOR = """
  floor:
    kind: floor
    fixed: true
    material: floor
    place: {position_m: [0.4, 0.0, -0.77]}
    shapes: [{kind: box, size_m: [3.0, 3.0, 0.02]}]
"""
TWINS = f"""{FLOOR}
  first: &cube
    kind: cube
    color: red
    material: red
    place: {{position_m: [0.48, -0.05, 0.0205], jitter_m: [0.001, 0.001, 0.0]}}
    shapes: [{{kind: box, size_m: [0.02, 0.02, 0.02]}}]
  second:
    <<: *cube
    place: {{position_m: [0.48, 0.05, 0.0205], jitter_m: [0.001, 0.001, 0.0]}}
  can:
    kind: can
    color: green
    material: green
    place: {{position_m: [0.62, 0.0, 0.0405], jitter_m: [0.001, 0.001, 0.0]}}
    shapes: [{{kind: cylinder, size_m: [0.026, 0.04]}}]
  screen:
    kind: screen
    color: blue
    material: blue
    place: {{position_m: [0.3, 0.3, 0.0805], jitter_m: [0.001, 0.001, 0.0]}}
    shapes: [{{kind: box, size_m: [0.01, 0.1, 0.08]}}]
"""
SCENE = render_table("test/twins", TWINS).replace("cameras: {}", TOP)
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
        noisy = sensors.get_noise(level).varies
        self.pipeline = Pipeline(build_inventory(spec), RobotMask(profile, folder), "panda", noisy=noisy)
        self.scene = Scene(name=scene, seed=seed, episode="one")
        self.time_s, self.belief, self.looks = 1.0, None, 0
        self.physics.queries.look()
        self.state = self.physics.queries.read_target({})

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
        self.physics.queries.look()
        return np.array(self.physics.queries.seen.xpos[self.physics.model.body(name).id])


def observe_now(world, stage, things=(), state=None):
    """What is perceived of a stage at its present time."""
    world._handle.latest = Step(time_s=stage.time_s, target=state or stage.state, tracking_error_rad=0.0)
    world.enter(stage.scene)
    return world.observe(Need(things=frozenset(things)) if things else WORLD)


def redate(frames, time_s):
    """The same pictures with another stamp."""
    return Frames(tuple(msgspec.structs.replace(frame, time_s=time_s) for frame in frames.frames))


def open_library(root, *scenes):
    """A project with these scene files."""
    (root / "scenes" / "test").mkdir(parents=True)
    for text in scenes:
        name = text.split("scene: test/", 1)[1].split("\n", 1)[0]
        (root / "scenes" / "test" / f"{name}.yaml").write_text(text)
    return Library.open(root)


@pytest.fixture(scope="module")
def twins_library(tmp_path_factory):
    return open_library(tmp_path_factory.mktemp("project"), SCENE)


@pytest.fixture
def twins(twins_library):
    return Stage(twins_library, "test/twins")
