"""A simulated target: MuJoCo behind the port. Paper section 4.5 (target-local constraints).

Upstream: `served_target`. Downstream: `physics`, `joint_controller`, `faults`. Time moves only by commands, halts and
holding; state is written only when a scene is loaded.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays
from phyagentos.protocol.world.scenes import SceneSpec, read_scene
from phyagentos.runtime.drivers.mujoco.cameras import CameraRig
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.initial_state import refuse_bad_state
from phyagentos.runtime.drivers.mujoco.joint_controller import JointController
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.drivers.mujoco.local_limits import END_MARGIN_RAD
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.rendering import render_png
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, build_robot, count_steps
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetDriver

PICTURE_MAX = 4096  # pixels of one side
TOOLS = (wire.Tool(wire.RENDER), wire.Tool(wire.SCENE_MODEL))


class RenderArguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the tool `render` takes."""

    camera: str
    width: int = 640
    height: int = 480


class MujocoDriver(TargetDriver):
    """One robot, one scene at a time.

    Args:
        profile: The robot.
        folder: Where its model lies.
        library: Where scenes are found.
        faults: Makes the injector of a new episode from its name and its scene's seed.
        mode: How it is served; stands in its description.
        sensors: The settings of its cameras; it has none without.
    """

    def __init__(
        self,
        profile: TargetProfile,
        folder: Path,
        library: Library,
        faults: Callable[[str, int], FaultInjector] | None = None,
        mode: WorldMode = WorldMode.LOCKSTEP,
        sensors: Sensors | None = None,
    ) -> None:
        self._sensors = sensors or Sensors(sensors={})
        self._rig: CameraRig | None = None
        self._mode = mode
        self._profile, self._folder, self._library = profile, folder, library
        self._make_faults = faults or (lambda _episode, _seed: FaultInjector())
        self._faults = self._make_faults("", 0)
        self._physics: Physics | None = None
        self._drive: JointController | None = None

    @property
    @override
    def time_s(self) -> float:
        return self._physics.time_s if self._physics is not None else float("nan")

    @property
    @override
    def control_period_s(self) -> float:
        return self._profile.control_period_s

    @property
    @override
    def is_moving(self) -> bool:
        return self._drive is not None and self._drive.is_moving

    @override
    def describe(self) -> wire.Description:
        profile = self._profile
        model = self._physics.model if self._physics else build_robot(profile, self._folder).compile()
        ranges = np.array([model.joint(name).range for name in profile.arm.joints])
        cameras = tuple(model.camera(index).name for index in range(model.ncam))
        return wire.Description(
            target=profile.target,
            n_joints=len(profile.arm.joints),
            steps_per_command=count_steps(profile),
            physics_step_s=profile.physics_step_s,
            q_min_rad=tuple((ranges[:, 0] + END_MARGIN_RAD).tolist()),
            q_max_rad=tuple((ranges[:, 1] - END_MARGIN_RAD).tolist()),
            observations=profile.observations,
            actions=profile.actions,
            cameras=cameras,
            mode=self._mode,
            kinematics=read_kinematics(model, profile),
            gripper_force_n=float(np.abs(model.actuator(GRIPPER_ACTUATOR).forcerange).max()),
            joints=profile.arm.joints,
            depth_cameras=self._rig.names if self._rig is not None else (),
            version=wire.WIRE_VERSION,
            driver="mujoco",
            tools=TOOLS,
            ground_truth=True,
            end_effector=profile.end_effector,
        )

    @override
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        spec = self._find_scene(request.scene)
        physics = Physics(self._profile, self._folder, spec, request.seed)
        physics.start(spec.settle_s)
        if request.snapshot:
            state = decode_arrays(request.snapshot).get("state", np.empty(0))
            refuse_bad_state(state, physics, self._profile)
            physics.restore(state)
        self._faults = self._make_faults(request.episode, request.seed)
        drive = JointController(self._profile, physics, self._faults, count_steps(self._profile))
        drive.hold(physics.q_rad if request.snapshot else np.array(self._profile.arm.home_rad))
        self._physics, self._drive = physics, drive
        self._rig = CameraRig(physics.model, self._sensors, request.seed, request.episode)
        return wire.Loaded(request.episode, physics.model_sha256)

    def _find_scene(self, name: str) -> SceneSpec:
        """The scene of a name; a world of the imagination has its own."""
        return read_scene(self._library.get_scene(name))

    @override
    def begin(self, session: str, epoch: int) -> None:
        self._get_drive().begin()
        self._get_drive().struck = list(self._faults.on_session(session))

    @override
    def end(self) -> tuple[wire.FaultStruck, ...]:
        super().end()
        return tuple(self._get_drive().struck)

    @override
    def apply(self, command: wire.Command) -> str:
        drive = self._get_drive()
        if refused := drive.check(command):
            raise ExecutionError(refused.code, refused.message)
        return drive.follow(command)

    @override
    def halt(self, category: int = 2) -> None:
        self._get_drive().halt()

    @override
    def hold(self, duration_s: float) -> None:
        self._get_drive().settle(duration_s)

    @override
    def report(self) -> wire.Step:
        physics, drive = self._get_physics(), self._get_drive()
        physics.look()
        return wire.Step(
            time_s=physics.time_s,
            target=physics.read_target(physics.find_touching()),
            tracking_error_rad=float(np.abs(physics.q_rad - drive.q_rad).max()),
            contact_force_n=drive.take_force(),
        )

    @override
    def observe(self, *, truth: bool) -> wire.Observation:
        physics = self._get_physics()
        physics.look()
        target = physics.read_target(physics.find_touching())
        if not truth:
            return wire.Observation(time_s=physics.time_s, target=target)
        return wire.Observation(
            time_s=physics.time_s,
            target=target,
            entities=physics.read_entities(self._profile.target, target.holding),
            regions=physics.regions,
        )

    @override
    def snapshot(self) -> wire.Artefact:
        """An NPZ of `state` (the mjSTATE_INTEGRATION vector), `time`, `qpos`, `qvel` and `act`."""
        physics = self._get_physics()
        arrays = {
            "state": physics.read_state(),
            "time": np.asarray(physics.time_s, dtype=np.float64),
            "qpos": np.array(physics.data.qpos),
            "qvel": np.array(physics.data.qvel),
            "act": np.array(physics.data.act),
        }
        return wire.Artefact(wire.NPZ, encode_arrays(arrays))

    @override
    def capture(self, request: wire.Capture) -> wire.Frames:
        physics, drive = self._get_physics(), self._get_drive()
        if self._rig is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._rig.capture(request, physics.time_s, drive.history, self._faults.find_lies)

    @override
    def invoke_tool(self, name: str, arguments: Mapping[str, Any]) -> wire.ToolResult:
        physics = self._get_physics()
        if name == wire.SCENE_MODEL:
            files = {name: wire.Artefact("application/octet-stream", data) for name, data in physics.export().items()}
            return wire.ToolResult(files)
        wanted = msgspec.convert(dict(arguments), RenderArguments)
        if not (1 <= wanted.width <= PICTURE_MAX and 1 <= wanted.height <= PICTURE_MAX):
            message = f"a picture of {wanted.width} x {wanted.height} pixels; 1 to {PICTURE_MAX} are possible"
            raise ExecutionError("MALFORMED", message)
        physics.look()
        return render_png(physics.model, physics.seen, wanted.camera, wanted.width, wanted.height)

    def _get_physics(self) -> Physics:
        if self._physics is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._physics

    def _get_drive(self) -> JointController:
        if self._drive is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._drive
