"""A stage for perception: objects on a table in a compiled model, cameras that look at them, hands that move them."""

import msgspec
import numpy as np
import pytest

from benchmarks.worlds.table import TOP, render_table
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.views import CameraView, Cloud
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
        self.library, spec = library, read_scene(library.get_scene(scene))
        self.physics = Physics.alone(profile, folder, spec, seed)
        self.physics.start(spec.settle_s)
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        self.cameras = open_cameras(self.physics.model, sensors, seed=seed, level=level)
        noisy = sensors.get_noise(level).varies
        self.mask = RobotMask(profile, folder)
        self.pipeline = Pipeline(build_inventory(spec), self.mask, "panda", noisy=noisy)
        self.scene = Scene(name=scene, seed=seed, episode="one")
        self.time_s, self.belief, self.looks = 1.0, None, 0
        self.physics.queries.look()
        self.state = self.physics.queries.read_target({})

    def put(self, name, x_m, y_m, z_m=None, yaw_rad=0.0, tilt_rad=0.0):
        """Set an object down somewhere."""
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
        self.looks += 1
        return self.capture(self.looks, cameras)

    def capture(self, number, cameras=(), crops=None, every=1, qpos=None):
        """What some cameras, or windows of them, show of a state; the noise is that of a number."""
        data = pose_state(self.physics.model, self.physics.data.qpos if qpos is None else qpos)
        rngs = {name: np.random.default_rng((number, index)) for index, name in enumerate(self.cameras)}
        crops, names = crops or {}, cameras or self.cameras
        shown = (self.cameras[n].capture(data, self.time_s, rngs[n], crops.get(n), every=every) for n in names)
        return Frames(tuple(shown))

    def grip(self, at_m, width_m=0.04, force_n=30.0):
        """The state of the robot as its fingers, pointing down, press on something of this width."""
        tcp = Pose(tuple(at_m), (0.0, 1.0, 0.0, 0.0))
        return msgspec.structs.replace(self.state, tcp=tcp, gripper_width_m=width_m, grip_force_n=force_n)

    def open_world(self, handle):
        """What perceives this stage by a handle."""
        return PerceivedWorld("panda", handle, self.library, self.mask)

    def look(self, frames=None, state=None, after_s=0.5, cameras=()):
        """The belief half a second later."""
        self.time_s += after_s
        frames = frames or self.take_frames(cameras)
        state = state or self.state
        self.belief = self.pipeline.sense(frames, state, self.scene, self.time_s, self.belief)
        return self.belief

    def find(self, name):
        """(3,) where an object really is."""
        self.physics.queries.look()
        return np.array(self.physics.queries.seen.xpos[self.physics.model.body(name).id])


def judge(text, belief):
    """The truth of a claim, as far as one belief shows it."""
    return parse_predicate(text).evaluate(View(now=belief, initial=None, target="panda")).truth


def spread(x, y, z):
    """Points (n, 3) at all combinations of these coordinates."""
    return np.column_stack([each.ravel() for each in np.meshgrid(x, y, z)])


def look_from(position_m):
    """A camera above, pointing down, that measured nothing by which a pose could be contradicted."""
    unknown = np.full((4, 4), np.inf, np.float32)
    return CameraView(
        camera="top", time_s=1.0, position_m=np.array(position_m), rotation=np.diag([1.0, -1.0, -1.0]),
        focal=(100.0, 100.0, 2.0, 2.0), nearest_m=unknown, farthest_m=unknown,
    )  # fmt: skip


def make_cloud(points_m, colors):
    """Points (n, 3) as the first camera sees them, all of one index of the palette or each of its own."""
    n = len(points_m)
    return Cloud(
        points_m=points_m, colors=np.broadcast_to(colors, n).astype(np.uint8), view_index=np.zeros(n, np.intp),
        pixels=np.zeros((n, 2), np.intp), rgb=np.zeros((n, 3), np.uint8),
    )  # fmt: skip


def observe_now(world, stage, objects=(), state=None):
    """What is perceived of a stage at its present time."""
    world._handle.latest = Step(time_s=stage.time_s, target=state or stage.state, tracking_error_rad=0.0)
    world.enter(stage.scene)
    return world.observe(Need(objects=frozenset(objects)) if objects else WORLD)


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
