"""A simulated target: MuJoCo behind the port, in lockstep. Paper section 4.5 (target-local constraints).

Upstream: `server`, or a test. Downstream: `physics`, `authority`, `faults`. Time moves only by commands, halts and
settling; state is written only when a scene is loaded. Requests are refused, never raised over the wire.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.scenes import SceneSpec, read_scene
from phyagentos.runtime.drivers.mujoco.cameras import CameraRig
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.initial_state import find_bad_state
from phyagentos.runtime.drivers.mujoco.joint_controller import JointController
from phyagentos.runtime.drivers.mujoco.kinematics import read_kinematics
from phyagentos.runtime.drivers.mujoco.local_limits import END_MARGIN_RAD
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.rendering import render_png
from phyagentos.runtime.models.robot import GRIPPER_ACTUATOR, build_robot, count_steps
from phyagentos.runtime.targets.authority import Authority
from phyagentos.runtime.targets.receive_log import STATE_WRITE, UNTOLD, ReceiveLog, Reception
from phyagentos.runtime.targets.wire import (
    WIRE_VERSION,
    Ack,
    Begin,
    Capture,
    Command,
    Describe,
    Description,
    End,
    Ended,
    Halt,
    Loaded,
    LoadScene,
    Observation,
    Observe,
    Refused,
    Render,
    Reply,
    Request,
    SaveModel,
    Settle,
    Shutdown,
    Step,
)

SETTLE_MAX_S = 60.0  # nothing needs longer to come to rest
PICTURE_MAX = 4096  # pixels of one side


class MujocoDriver:
    """One robot, one scene at a time.

    Args:
        profile: The robot.
        folder: Where its model lies.
        library: Where scenes are found.
        log: The receive log.
        faults: Makes the injector of a new episode from its name and its scene's seed.
        is_estopped: Whether the emergency stop is latched.
        mode: How it is served; told to whoever asks.
        sensors: The settings of its cameras; it has none without.
        keep_stop: Makes the latch durable; called once the arm is at rest, since a disk may take its time.
    """

    def __init__(
        self,
        profile: TargetProfile,
        folder: Path,
        library: Library,
        log: ReceiveLog,
        faults: Callable[[str, int], FaultInjector] | None = None,
        is_estopped: Callable[[], bool] = lambda: False,
        mode: WorldMode = WorldMode.LOCKSTEP,
        sensors: Sensors | None = None,
        keep_stop: Callable[[], None] = lambda: None,
    ) -> None:
        self._sensors = sensors or Sensors(sensors={})
        self._rig: CameraRig | None = None
        self._is_estopped, self._keep_stop, self._mode = is_estopped, keep_stop, mode
        self._profile, self._folder, self._library, self._log = profile, folder, library, log
        self._make_faults = faults or (lambda _episode, _seed: FaultInjector())
        self._faults = self._make_faults("", 0)
        self._authority = Authority()
        self._episode = ""
        self._physics: Physics | None = None
        self._scene: tuple[str, int] = ("", 0)
        self._drive: JointController | None = None

    def close(self) -> None:
        """Let go of the log."""
        self._log.close()

    def withdraw(self) -> None:
        """Nobody is connected any more: the arm comes to rest and holds, authority ends."""
        if self._authority.session:
            self._authority.end()
            self._rest()
            self._log.stamp()
            self._log.note(Reception(time_s=self._now_s(), kind="Withdraw", episode=self._episode))

    @property
    def time_s(self) -> float:
        """Simulated time [s]; NaN while no scene is loaded."""
        return self._physics.time_s if self._physics is not None else float("nan")

    @property
    def control_period_s(self) -> float:
        """Length of a command [s]."""
        return self._profile.control_period_s

    @property
    def is_moving(self) -> bool:
        """Whether the set-points stopped in the middle of a motion."""
        return self._drive is not None and self._drive.is_moving

    def coast(self) -> None:
        """One control period without a command: a motion that was left in its middle is stopped, then the arm holds."""
        if self._drive is None:
            return
        if self._drive.is_moving and self._authority.session:
            self._authority.stop("DEADMAN")
            self._log.stamp()
            self._log.note(Reception(time_s=self._now_s(), kind="Deadman", episode=self._episode))
        self._drive.settle(self.control_period_s)

    def look_for_stops(self) -> bool:
        """Come to rest where the emergency stop is latched; whether it is."""
        if not self._is_estopped():
            return False
        if self._authority.session and self._authority.stopped != "ESTOPPED":
            self._authority.stop("ESTOPPED")
            self._rest()
            self._log.stamp()
            self._log.note(Reception(time_s=self._now_s(), kind="EStop", episode=self._episode))
        self._keep_stop()
        return True

    def handle(self, request: Request) -> Reply:
        """Carry out one request, or refuse it."""
        self._log.stamp()
        try:
            reply = self._refuse_untold(request) or self._carry_out(request)
        except (ExecutionError, DefinitionError) as error:
            code = error.code if isinstance(error, ExecutionError) else error.problems[0].code
            reply = Refused(code, str(error))
        except (OSError, ValueError) as error:  # a folder that is not there, a name with a zero byte
            reply = Refused("MALFORMED", f"{type(request).__name__}: {error}")
        self._note(request, reply)
        return reply

    def _refuse_untold(self, request: Request) -> Refused | None:
        is_new = isinstance(request, Begin | Command)
        return Refused("LOG_UNWRITABLE", UNTOLD) if is_new and self._log.is_behind else None

    def _carry_out(self, request: Request) -> Reply:
        match request:
            case Command():
                self.look_for_stops()
                return self._apply(request)
            case Observe():
                return self._observe()
            case Halt():
                return self._authority.check(request.session, request.epoch) or self._halt(request.category)
            case Settle():
                return self._authority.check(request.session, request.epoch) or self._settle(request.duration_s)
            case Begin():
                return self._begin(request)
            case End():
                return self._authority.check(request.session, request.epoch) or self._end()
            case LoadScene():
                return self._load(request)
            case Describe():
                return self._describe()
            case Render():
                return self._render(request)
            case Capture():
                return self._capture(request)
            case SaveModel():
                return self._save(Path(request.folder))
            case Shutdown():
                return Ack()

    def _describe(self) -> Description:
        profile = self._profile
        model = self._physics.model if self._physics else build_robot(profile, self._folder).compile()
        ranges = np.array([model.joint(name).range for name in profile.arm.joints])
        cameras = tuple(model.camera(index).name for index in range(model.ncam))
        return Description(
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
            version=WIRE_VERSION,
        )

    def _load(self, request: LoadScene) -> Reply:
        if self._authority.session:
            return Refused(
                "NO_AUTHORITY", f"{self._authority.session} has authority; scenes are loaded between sessions"
            )
        scene = (request.scene, request.seed)
        if request.episode == self._episode and self._physics is not None and request.state is None:
            if scene != self._scene:
                return Refused("EPISODE_CONFLICT", f"episode {request.episode} is {self._scene}, not {scene}")
            return Loaded(request.episode, self._physics.model_sha256)
        if self._physics is not None and not request.may_reset:
            message = f"episode {request.episode} would end episode {self._episode}, and its contract permits no reset"
            return Refused("RESET_FORBIDDEN", message)
        spec = self._find_scene(request.scene)
        physics = Physics(self._profile, self._folder, spec, request.seed)
        physics.start(spec.settle_s)
        if request.state is not None:
            if refused := find_bad_state(request.state, physics, self._profile):
                return refused
            physics.restore(request.state)
        self._faults = self._make_faults(request.episode, request.seed)
        drive = JointController(self._profile, physics, self._faults, count_steps(self._profile))
        drive.hold(physics.q_rad if request.state is not None else np.array(self._profile.arm.home_rad))
        self._physics, self._drive, self._episode, self._scene = physics, drive, request.episode, scene
        self._rig = CameraRig(physics.model, self._sensors, request.seed, request.episode)
        self._log.note(Reception(time_s=physics.time_s, kind=STATE_WRITE, episode=self._episode))
        return Loaded(request.episode, physics.model_sha256)

    def _find_scene(self, name: str) -> SceneSpec:
        """The scene of a name; a world of the imagination has its own."""
        return read_scene(self._library.get_scene(name))

    def _begin(self, request: Begin) -> Reply:
        self._get_physics()
        if self.look_for_stops():
            return Refused("ESTOPPED", "the emergency stop is latched; `paos estop --reset` ends it")
        refused = self._authority.begin(request.session, request.epoch)
        if refused is None:
            self._get_drive().begin()
            self._get_drive().struck = list(self._faults.on_session(request.session))
        return refused or Ack()

    def _end(self) -> Reply:
        self._rest()
        self._authority.end()
        return Ended(self._now_s(), tuple(self._get_drive().struck))

    def _rest(self) -> None:
        """Whoever commanded is gone: a motion that was left in its middle comes to an end here."""
        if self._drive is not None and self._drive.is_moving:
            self._drive.halt()

    def _apply(self, command: Command) -> Reply:
        physics, drive = self._get_physics(), self._get_drive()
        authority = self._authority
        refused = (
            authority.check_commanding(command.session, command.epoch)
            or drive.check(command)
            or authority.admit(command, physics.time_s)
        )
        if refused is not None:
            return refused
        stopped = drive.follow(command)
        if stopped:
            self._authority.stop(stopped)
        return self._report(physics, stopped)

    def _halt(self, category: int) -> Step:
        """Come to rest; after a stop of category 1 the session commands no more."""
        self._get_drive().halt()
        if category == 1 and not self._authority.stopped:
            self._authority.stop("DRIVES_OFF")
        return self._report(self._get_physics())

    def _settle(self, duration_s: float) -> Reply:
        if not 0.0 <= duration_s <= SETTLE_MAX_S:  # also when it is NaN
            return Refused("MALFORMED", f"a settling time of {duration_s} s; 0 to {SETTLE_MAX_S} s are possible")
        self._get_drive().settle(duration_s)
        return self._report(self._get_physics())

    def _report(self, physics: Physics, stopped: str = "") -> Step:
        physics.look()
        return Step(
            time_s=physics.time_s,
            target=physics.read_target(physics.find_touching()),
            tracking_error_rad=float(np.abs(physics.q_rad - self._get_drive().q_rad).max()),
            stopped=stopped,
            contact_force_n=self._get_drive().take_force(),
        )

    def _observe(self) -> Observation:
        physics = self._get_physics()
        physics.look()
        target = physics.read_target(physics.find_touching())
        return Observation(
            time_s=physics.time_s,
            target=target,
            state=physics.read_state(),
            qpos=np.array(physics.data.qpos),
            qvel=np.array(physics.data.qvel),
            act=np.array(physics.data.act),
            entities=physics.read_entities(self._profile.target, target.holding),
            regions=physics.regions,
        )

    def _render(self, request: Render) -> Reply:
        physics = self._get_physics()
        if not (1 <= request.width <= PICTURE_MAX and 1 <= request.height <= PICTURE_MAX):
            return Refused("MALFORMED", f"a picture of {request.width} x {request.height} pixels; 1 to {PICTURE_MAX}")
        physics.look()
        return render_png(physics.model, physics.seen, request.camera, request.width, request.height)

    def _capture(self, request: Capture) -> Reply:
        physics, drive = self._get_physics(), self._get_drive()
        if self._rig is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._rig.capture(request, physics.time_s, drive.history, self._faults.find_lies)

    def _save(self, folder: Path) -> Reply:
        physics = self._get_physics()
        if not folder.is_dir():  # MuJoCo itself would only warn
            return Refused("MALFORMED", f"no folder {folder}")
        physics.save(folder)
        return Ack()

    def _get_physics(self) -> Physics:
        if self._physics is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._physics

    def _get_drive(self) -> JointController:
        if self._drive is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._drive

    def _now_s(self) -> float:
        return self._physics.time_s if self._physics is not None else 0.0

    def _note(self, request: Request, reply: Reply) -> None:
        if isinstance(request, Observe | Describe | Render | Capture | SaveModel | Shutdown):
            return
        self._log.note(
            Reception(
                time_s=self._now_s(),
                kind=type(request).__name__,
                episode=self._episode,
                session=getattr(request, "session", ""),
                epoch=getattr(request, "epoch", 0),
                sequence=getattr(request, "sequence", 0),
                accepted=not isinstance(reply, Refused),
                code=reply.code if isinstance(reply, Refused) else "",
            )
        )
