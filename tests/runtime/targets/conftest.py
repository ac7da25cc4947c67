"""A simulated world, and an arm that is driven by a few lines of its own."""

import mujoco
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.workspace.array_files import decode_arrays
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector, Schedule, draw_schedule
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.simulated_camera import pose_state
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget

SCENE = "tabletop/cubes_and_trays"


@pytest.fixture(scope="session")
def library():
    return Library.open()


@pytest.fixture(scope="session")
def panda(library):
    return read_profile(library.get_target("panda"))


class Rig:
    """A world with authority, and simple motions."""

    def __init__(
        self, library, panda, log=None, schedule: Schedule | FaultFile | None = None, sensors: Sensors | None = None
    ) -> None:
        self.profile, folder = panda
        make = lambda episode, seed: FaultInjector(  # noqa: E731
            draw_schedule(schedule, episode, seed) if isinstance(schedule, FaultFile) else schedule or Schedule()
        )
        self.driver = MujocoDriver(SimulatedWorld(library, faults=make, sensors=sensors), self.profile, folder)
        self.world = ServedTarget(self.driver, ReceiveLog(log))
        self.sequence = 0
        self.session = "s"

    def load(self, seed=1, scene=SCENE, episode="e", snapshot=b""):
        return self.world.handle(wire.LoadScene(scene=scene, seed=seed, episode=episode, snapshot=snapshot))

    def begin(self, session="s", epoch=1):
        self.session, self.epoch, self.sequence = session, epoch, 0
        return self.world.handle(wire.Begin(session=session, epoch=epoch))

    def observe(self):
        return self.world.handle(wire.Observe(truth=True, snapshot=True))

    def read_state(self):
        """What is stored of the present: arrays by name."""
        return decode_arrays(self.driver.snapshot().data)

    def entity(self, name):
        return next(each for each in self.observe().entities if each.name == name)

    def make_command(self, q, width=0.08, qd=None, **changes):
        rows = np.tile(np.asarray(q, dtype=float), (10, 1)) if np.ndim(q) == 1 else q
        facts = {
            "session": self.session, "epoch": self.epoch, "sequence": self.sequence + 1, "expires_at_s": 1e9,
            "q_rad": rows, "qd_rad_s": np.zeros_like(rows) if qd is None else qd,
            "gripper_width_m": np.full(len(rows), width),
        }  # fmt: skip
        return wire.Command(**{**facts, **changes})

    def send(self, command):
        reply = self.world.handle(command)
        if isinstance(reply, wire.Step):
            self.sequence += 1
        return reply

    def plan(self, goal, seconds=1.5):
        """Smoothly from the present set-point to a posture, in at least this time and within the velocity limits.

        Returns:
            Rows (10, 7) of positions and velocities, one pair a command.
        """
        start = np.array(self.driver.controller.q_rad)
        way = np.asarray(goal) - start
        fastest = 2.1 * float(np.max(np.abs(way) / np.array(self.profile.arm.velocity_rad_s)))
        n = round(max(seconds, fastest) / 0.02)
        s, duration = (np.arange(1, 10 * n + 1) / (10 * n))[:, None], 0.02 * n
        q = start + (10 * s**3 - 15 * s**4 + 6 * s**5) * way
        qd = (30 * s**2 - 60 * s**3 + 30 * s**4) / duration * way
        return list(zip(np.split(q, n), np.split(qd, n), strict=True))

    def move(self, goal, width=0.08, seconds=1.5):
        """Go to a posture."""
        for q, qd in self.plan(goal, seconds):
            reply = self.send(self.make_command(q, width, qd))
            assert isinstance(reply, wire.Step), reply
        return reply

    def hold(self, width, seconds):
        return self.move(self.driver.controller.q_rad, width, seconds)

    def reach(self, point, yaw=0.0):
        """Joint angles that bring the tool to a point, pointing down (damped least squares on MuJoCo's Jacobian)."""
        model, data = self.driver.physics.model, mujoco.MjData(self.driver.physics.model)
        site, dofs = model.site("tcp").id, self.driver.physics.state.v_address
        q = np.array(self.profile.arm.home_rad)
        wanted = np.array([[np.cos(yaw), np.sin(yaw), 0], [np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1]]).T
        jacobian_p, jacobian_r = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for _ in range(200):
            data.qpos[self.driver.physics.state.q_address] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            rotation = data.site_xmat[site].reshape(3, 3)
            turn = 0.5 * sum(np.cross(rotation[:, k], wanted[:, k]) for k in range(3))
            error = np.concatenate([np.asarray(point) - data.site_xpos[site], turn])
            if np.linalg.norm(error) < 1e-4:
                break
            mujoco.mj_jacSite(model, data, jacobian_p, jacobian_r, site)
            J = np.vstack([jacobian_p[:, dofs], jacobian_r[:, dofs]])
            q = q + np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), error), -0.2, 0.2)
        return q

    def grasp(self, name):
        """Take a cube and lift it by 15 cm."""
        pose = self.entity(name).pose
        w, _, _, z = pose.quaternion_wxyz
        yaw = 2 * np.arctan2(z, w)
        x, y, _ = pose.position_m
        self.move(self.reach((x, y, 0.14), yaw))
        self.move(self.reach((x, y, 0.02), yaw))
        self.hold(0.0, 0.4)
        return self.move(self.reach((x, y, 0.17), yaw), width=0.0)


@pytest.fixture
def make_rig(library, panda):
    rigs: list[Rig] = []

    def make(**options) -> Rig:
        rigs.append(Rig(library, panda, **options))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.world.close()


@pytest.fixture
def rig(make_rig):
    rig = make_rig()
    rig.load()
    rig.begin()
    return rig


@pytest.fixture(scope="module")
def physics(library, panda):
    spec = read_scene(library.get_scene("tabletop/cubes_and_trays"))
    physics = Physics.alone(*panda, spec, 7)
    physics.start(spec.settle_s)
    return physics


@pytest.fixture(scope="module")
def data(physics):
    return pose_state(physics.model, physics.data.qpos)
