"""Simulated targets: robots of a MuJoCo world behind the port. Paper section 4.5 (target-local constraints).

Time moves only by commands, halts and holding; state is written only when a scene is loaded.
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.evidence import MOTION
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays
from phyagentos.protocol.world.environment import TargetState
from phyagentos.protocol.world.idealisations import Aspect, Idealisation
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.cameras import CameraRig
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.inter_robot_collisions import InterRobotCollisions
from phyagentos.runtime.drivers.mujoco.joint_controller import JointController, Motion
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.drivers.mujoco.local_limits import END_MARGIN_RAD
from phyagentos.runtime.drivers.mujoco.physics import Physics, advance
from phyagentos.runtime.drivers.mujoco.rendering import render_ahead, render_png
from phyagentos.runtime.drivers.mujoco.simulation import BROKEN_OFF, ReadAgreement, Simulation
from phyagentos.runtime.models.robot import compile_robot, count_steps
from phyagentos.runtime.models.world import CompiledScene, compile_scene, name_prefix
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetDriver

PICTURE_MAX = 4096  # pixels of one side
MOTION_PERIOD_S = 0.04
TOOLS = tuple(map(wire.Tool, (wire.RENDER, wire.SCENE_MODEL, wire.MOTION)))
BESIDE = tuple(map(wire.Tool, (wire.RENDER_AHEAD, wire.PICTURES)))  # in real time it would make commands late


class RenderArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of the tools `render` and `render_ahead`."""

    camera: str
    width: int = 640
    height: int = 480
    name: str = ""


class PicturesArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of the tool `pictures`."""

    wait: bool = False


class SimulatedWorld:
    """One scene at a time, with the robots that joined.

    `faults` makes the injector of a new episode from its name and its scene's seed.
    """

    def __init__(
        self,
        library: Library,
        *,
        faults: Callable[[str, int], FaultInjector] | None = None,
        mode: WorldMode = WorldMode.LOCKSTEP,
        sensors: Sensors | None = None,
        read_agreement: ReadAgreement | None = None,
    ) -> None:
        self.mode, self.sensors = mode, sensors or Sensors(sensors={})
        self.simulation = Simulation(read_agreement)
        self.robots: dict[str, MujocoDriver] = {}
        self._library, self._make_faults = library, faults or (lambda _episode, _seed: FaultInjector())
        self._present: tuple[wire.LoadScene, wire.Loaded] | None = None

    @property
    def episode(self) -> str:
        """The present one; empty before the first."""
        return self._present[0].episode if self._present is not None else ""

    def join(self, name: str, robot: "MujocoDriver") -> None:
        """Add a robot, before the first scene is loaded."""
        self.robots = dict(sorted({**self.robots, name: robot}.items()))
        self.simulation.join(name, robot)
        self.simulation.control_period_s = robot.control_period_s

    def find_scene(self, name: str) -> SceneSpec:
        """The scene of a name."""
        return read_placed(self._library, name)

    def load(self, request: wire.LoadScene) -> wire.Loaded:
        """Begin an episode, or join the present one that another robot began.

        Raises:
            ExecutionError: `BUSY`, `NO_AUTHORITY`, `NOT_PERMITTED` for the sake of another robot's
                episode; `MALFORMED`, `TARGET_LIMIT` for a snapshot; `SCENE_INVALID`.
        """
        if len(self.robots) > 1 and self._present is not None and not request.snapshot:
            standing, loaded = self._present
            if request.episode == standing.episode:
                known, wanted = (standing.scene, standing.seed), (request.scene, request.seed)
                if known != wanted:
                    raise ExecutionError("BUSY", f"episode {request.episode} is {known}, not {wanted}")
                return loaded
            busy = next((robot.session for robot in self.robots.values() if robot.session), "")
            if busy:
                raise ExecutionError("NO_AUTHORITY", f"{busy} has authority in episode {standing.episode}")
            if not request.may_reset:
                raise ExecutionError(
                    "NOT_PERMITTED",
                    message=f"episode {request.episode} would end episode {standing.episode}; no reset is permitted",
                )
        spec = self.find_scene(request.scene)
        scene = compile_scene([(each.profile, each.folder) for each in self.robots.values()], spec, request.seed)
        bodies = {name: Physics(each.profile, scene, each.prefix) for name, each in self.robots.items()}
        mujoco.mj_resetData(scene.model, scene.data)
        for physics in bodies.values():
            physics.actuation.place_at_home()
        advance(bodies.values(), round(spec.settle_s / scene.model.opt.timestep))
        if request.snapshot:
            state = decode_arrays(request.snapshot).get("state", np.empty(0))
            for physics in bodies.values():
                physics.state.refuse_bad_state(state)
            next(iter(bodies.values())).state.restore(state)
        if len(self.robots) > 1:
            scene.export()  # while no robot moves: its XML takes 0.15 s, in which no other thread runs
        self._enter(request, scene, bodies)
        return self._present[1] if self._present is not None else wire.Loaded(request.episode, scene.model_sha256)

    def _enter(self, request: wire.LoadScene, scene: CompiledScene, bodies: Mapping[str, Physics]) -> None:
        faults = self._make_faults(request.episode, request.seed)
        for name, physics in bodies.items():
            robot = self.robots[name]
            own = faults if name == next(iter(bodies)) else faults.fork()
            controller = JointController(robot.profile, physics, own, count_steps(robot.profile))
            controller.hold(physics.state.q_rad if request.snapshot else np.array(robot.profile.arm.home_rad))
            rig = CameraRig(scene.model, self.sensors, request.seed, request.episode, robot.prefix)
            robot.enter(Embodiment(physics, controller, rig, own))
        self._present = request, wire.Loaded(request.episode, scene.model_sha256)
        self.simulation.begin_episode(scene, InterRobotCollisions(bodies) if len(bodies) > 1 else None)

    def admit(self, name: str, motion: wire.Announce) -> Motion:
        """Admit a motion, in no time; returns the robot in its way. Those of one moment come in the order of names."""
        yield from ()
        held = {each: robot.look().holding for each, robot in self.robots.items()}
        collisions = self.simulation.collisions
        return collisions.admit(name, motion.q_rad, motion.beside, held) if collisions is not None else ""


@dataclass(frozen=True, slots=True)
class Embodiment:
    """A robot in the present episode: its part of the model, its joints, its cameras, its faults."""

    physics: Physics
    controller: JointController
    rig: CameraRig
    faults: FaultInjector


class MujocoDriver(TargetDriver):
    """One robot of a simulated world, whose model is in `folder`."""

    def __init__(self, world: SimulatedWorld, profile: TargetProfile, folder: Path) -> None:
        self.world, self.profile, self.folder = world, profile, folder
        self.session = ""
        self._present: Embodiment | None = None
        self._moved: list[tuple[float, NDArray[np.float64]]] = []  # simulated time and (nq,) of the whole world
        self._begun: dict[str, Future[wire.ToolResult]] = {}  # pictures of this session
        world.join(profile.target, self)

    @property
    def prefix(self) -> str:
        """Of its names in the model."""
        return name_prefix(self.profile.target, len(self.world.robots))

    @property
    def physics(self) -> Physics:
        """Its part of the model, in the present episode."""
        return self._get_present().physics

    @property
    def controller(self) -> JointController:
        """Of its joints, in the present episode."""
        return self._get_present().controller

    def enter(self, present: Embodiment) -> None:
        """Another episode begins."""
        self._present = present

    def look(self) -> TargetState:
        """Its own state now."""
        self.physics.queries.look()
        return self.physics.queries.read_target(self.physics.queries.find_touching())

    @property
    @override
    def time_s(self) -> float:
        return self.world.simulation.time_s

    @property
    @override
    def is_moving(self) -> bool:
        return self._present is not None and self._present.controller.is_moving

    @override
    def describe(self) -> wire.Description:
        profile, present = self.profile, self._present
        scene = present.physics.model if present is not None else None
        model = scene
        if model is None or profile.base is not None:
            model = compile_robot(profile, self.folder)
        prefix = self.prefix if model is scene else ""  # alone, a base has joints for its pose
        seen = scene if scene is not None else model
        ranges = np.array([model.joint(prefix + name).range for name in profile.arm.joints])
        return self.describe_profile(
            q_min_rad=tuple((ranges[:, 0] + END_MARGIN_RAD).tolist()),
            q_max_rad=tuple((ranges[:, 1] - END_MARGIN_RAD).tolist()),
            cameras=tuple(seen.camera(index).name for index in range(seen.ncam)),
            mode=self.world.mode,
            kinematics=read_kinematics(model, profile, prefix),
            depth_cameras=present.rig.names if present else (),
            counts_frames=True,
            driver="mujoco",
            tools=(*TOOLS, *(BESIDE if self.world.mode is WorldMode.LOCKSTEP else ())),
            ground_truth=True,
            shares_time=len(self.world.robots) > 1,
            idealisations=tuple(self._list_idealisations()),
        )

    def _list_idealisations(self) -> Iterator[Idealisation]:
        arm, gripper, sensors = self.profile.arm, self.profile.gripper, self.world.sensors
        if self._present is not None and (bodies := self._present.physics.scene.idealised):
            yield Idealisation(Aspect.FRICTION, ", ".join(bodies))
        if gripper.pads and gripper.pad_surface is None:
            yield Idealisation(Aspect.FRICTION, ", ".join(gripper.pads))
        if gripper.pads and not gripper.mass_kg:
            yield Idealisation(Aspect.HAND_MASS)
        if not (arm.position_noise_rad and arm.velocity_noise_rad_s and arm.state_delay_s):
            yield Idealisation(Aspect.JOINT_SENSORS)
        if not (self.profile.force_bias_n and self.profile.force_noise_n):
            yield Idealisation(Aspect.CONTACT_FORCE)
        noise = sensors.get_noise()
        if not (noise.varies and noise.glass_dropout and noise.black_dropout and noise.exposure_s):
            yield Idealisation(Aspect.CAMERAS, f"noise level {sensors.noise_level}")
        elif sensors.backend == "render":
            yield Idealisation(Aspect.CAMERAS, "glass and black surfaces have depth")

    @override
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        return self.world.load(request)

    @override
    def begin(self, session: str, epoch: int) -> None:
        present, self.session = self._get_present(), session
        if self.is_moving:
            self.world.simulation.ending.add(self.profile.target)
            self.world.simulation.carry_out(self.profile.target, present.controller.halt())
        self.world.simulation.ending.discard(self.profile.target)
        present.controller.begin()
        self._moved, self._begun = [], {}
        present.controller.activations = list(present.faults.on_session(session))

    @override
    def end(self) -> tuple[wire.RecordedFault, ...]:
        self.session = ""
        self.world.simulation.let_stand(self.profile.target)
        return tuple(self.controller.activations)

    @override
    def announce(self, motion: wire.Announce) -> str:
        shape, n_joints = motion.q_rad.shape, len(self.profile.arm.joints)
        if shape[1:] != (n_joints,) or not shape[0] or not np.isfinite(motion.q_rad).all():
            raise ExecutionError("MALFORMED", f"postures of shape {shape}; expected (n, {n_joints}), all finite")
        name = self.profile.target
        blocked_by = self.world.simulation.carry_out(name, self.world.admit(name, motion), may_abort=True)
        if blocked_by in BROKEN_OFF:
            raise ExecutionError(blocked_by, "the announcement was broken off")
        return blocked_by

    @override
    def apply(self, command: wire.Command) -> str:
        if refused := self.controller.check(command):
            raise ExecutionError(refused.code, refused.message)
        motion = self.controller.follow(command, is_alone=len(self.world.robots) == 1)
        stopped = self.world.simulation.carry_out(self.profile.target, motion, may_abort=True)
        if stopped in BROKEN_OFF:
            raise ExecutionError(stopped, "the command was broken off; the robot has come to rest")
        return stopped

    @override
    def halt(self, category: int = 2) -> None:
        self.world.simulation.carry_out(self.profile.target, self._come_to_rest())

    def _come_to_rest(self) -> Motion:
        """Halt; what was announced is over with the first physics step, which all robots take together."""
        if (collisions := self.world.simulation.collisions) is not None:
            collisions.withdraw(self.profile.target)
        return (yield from self.controller.halt())

    @override
    def hold(self, duration_s: float) -> None:
        if duration_s > 0.0 or self.is_moving:
            motion = self.controller.settle(duration_s, is_alone=len(self.world.robots) == 1)
            self.world.simulation.carry_out(self.profile.target, motion)

    @override
    def report(self) -> wire.Step:
        physics, controller, collisions = self.physics, self.controller, self.world.simulation.collisions
        if not self._moved or physics.time_s >= self._moved[-1][0] + MOTION_PERIOD_S - physics.model.opt.timestep:
            self._moved.append((physics.time_s, physics.data.qpos.copy()))
        return wire.Step(
            time_s=physics.time_s,
            target=self.look(),
            tracking_error_rad=physics.actuation.find_lag(controller.q_rad),
            contact_force_n=controller.take_force(),
            contact_force_error_n=controller.force_error_n,
            touched_n={} if collisions is None else collisions.take_touched(self.profile.target),
        )

    @override
    def observe(self, *, truth: bool) -> wire.Observation:
        physics, collisions = self.physics, self.world.simulation.collisions
        states = {name: robot.look() for name, robot in self.world.robots.items()}
        holders = {entity: name for name, state in states.items() for entity in state.holding}
        target = states.pop(self.profile.target)
        neighbours: tuple[wire.Neighbour, ...] = ()
        if collisions is not None:
            neighbours = tuple(
                wire.Neighbour(name, state, collisions.find_announced(name)) for name, state in states.items()
            )
        seen = wire.Observation(time_s=physics.time_s, target=target, neighbours=neighbours)
        if not truth:
            return seen
        return msgspec.structs.replace(
            seen, entities=physics.queries.read_entities(holders), regions=physics.scene.regions
        )

    @override
    def snapshot(self) -> wire.Artefact:
        """An NPZ of `state` (the mjSTATE_INTEGRATION vector), `time`, `qpos`, `qvel` and `act`."""
        physics = self.physics
        arrays = {
            "state": physics.state.read_state(),
            "time": np.asarray(physics.time_s, dtype=np.float64),
            "qpos": np.array(physics.data.qpos),
            "qvel": np.array(physics.data.qvel),
            "act": np.array(physics.data.act),
        }
        return wire.Artefact(wire.NPZ, encode_arrays(arrays))

    @override
    def capture(self, request: wire.Capture) -> wire.Frames:
        present = self._get_present()
        with self.world.simulation.lock:
            time_s, history = present.physics.time_s, present.controller.history.copy()
        return present.rig.capture(request, time_s, history, present.faults.find_sensor_corruption)

    @override
    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> wire.ToolResult:
        physics = self.physics
        if name == wire.SCENE_MODEL:
            files = {
                name: wire.Artefact("application/octet-stream", data) for name, data in physics.scene.export().items()
            }
            return wire.ToolResult(files)
        if name == wire.MOTION:
            qpos = np.array([each for _, each in self._moved], np.float32).reshape(-1, physics.model.nq)
            arrays = {"time_s": np.array([time_s for time_s, _ in self._moved]), "qpos": qpos}
            return wire.ToolResult({MOTION: wire.Artefact(wire.NPZ, encode_arrays(arrays))})
        if name == wire.PICTURES:
            waits = msgspec.convert(dict(arguments), PicturesArguments).wait
            done = [each for each, drawn in self._begun.items() if waits or drawn.done()]
            drawn = ((each, self._begun.pop(each).result().artefacts) for each in done)
            return wire.ToolResult({each: files[wire.PICTURE] for each, files in drawn if files})
        wanted = msgspec.convert(dict(arguments), RenderArguments)
        if not (1 <= wanted.width <= PICTURE_MAX and 1 <= wanted.height <= PICTURE_MAX):
            raise ExecutionError(
                "MALFORMED",
                message=f"a picture of {wanted.width} x {wanted.height} pixels; 1 to {PICTURE_MAX} are possible",
            )
        simulation = self.world.simulation
        with simulation.lock:
            others = (name for name, body in simulation.bodies.items() if body.session and name != self.profile.target)
            if simulation.is_paced and (other := next(others, "")):
                return wire.ToolResult({}, f"in real time, a picture would make {other} late, which runs a session")
            physics.queries.look()
            seen = copy(physics.queries.seen)
        if name == wire.RENDER_AHEAD:
            begun = render_ahead(physics.model, seen, wanted.camera, wanted.width, wanted.height)
            self._begun[wanted.name] = begun
            return wire.ToolResult({})
        return render_png(physics.model, seen, wanted.camera, wanted.width, wanted.height)

    def _get_present(self) -> Embodiment:
        if self._present is None:
            raise ExecutionError("REQUEST_INVALID", "no scene is loaded; send LoadScene first")
        return self._present
