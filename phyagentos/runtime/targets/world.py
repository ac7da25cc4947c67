"""A simulated target: MuJoCo behind the port, in lockstep. Paper section 4.5 (target-local constraints).

Upstream: `server`, or a test. Downstream: `physics`, `authority`, `faults`. Time moves only by commands, halts and
settling; state is written only when a scene is loaded. Requests are refused, never raised over the wire.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.library import Library
from phyagentos.protocol.scenes import read_scene
from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.targets.authority import Authority
from phyagentos.runtime.targets.faults import FaultInjector
from phyagentos.runtime.targets.physics import Array, Physics
from phyagentos.runtime.targets.receive_log import ReceiveLog, Reception
from phyagentos.runtime.targets.rendering import render_png
from phyagentos.runtime.targets.robot import build_robot, count_steps
from phyagentos.runtime.targets.wire import (
    Ack,
    Begin,
    Command,
    Describe,
    Description,
    End,
    Ended,
    FaultStruck,
    Halt,
    Loaded,
    LoadScene,
    Observation,
    Observe,
    Picture,
    Refused,
    Render,
    Reply,
    Request,
    SaveModel,
    Settle,
    Shutdown,
    Step,
)

SPEED_TOLERANCE = 1.5  # a set-point may run ahead of the velocity limit by this factor, not more
ROUNDING = 1e-6  # limits are closed intervals
HALT_MAX_S = 2.0  # longest deceleration to a hold
REST_RAD_S = 0.01  # every joint slower than this is at rest


class MujocoWorld:
    """One robot, one scene at a time.

    Args:
        profile: The robot.
        folder: Where its model lies.
        library: Where scenes are found.
        log: The receive log.
        faults: Makes the injector of a new episode from its name and its scene's seed.
    """

    def __init__(
        self,
        profile: TargetProfile,
        folder: Path,
        library: Library,
        log: ReceiveLog,
        faults: Callable[[str, int], FaultInjector] | None = None,
    ) -> None:
        self._profile, self._folder, self._library, self._log = profile, folder, library, log
        self._make_faults = faults or (lambda _episode, _seed: FaultInjector())
        self._faults = self._make_faults("", 0)
        self._authority = Authority()
        self._episode = ""
        self._physics: Physics | None = None
        self._scene: tuple[str, int] = ("", 0)
        self._held: Array = np.array(profile.arm.home_rad)
        self._jump_max_rad = SPEED_TOLERANCE * np.array(profile.arm.velocity_rad_s) * profile.physics_step_s
        self._width_m = profile.gripper.max_width_m
        self._struck: list[FaultStruck] = []

    def close(self) -> None:
        """Let go of the log."""
        self._log.close()

    def withdraw(self) -> None:
        """Nobody is connected any more: the arm holds where it is, authority ends."""
        if self._authority.session:
            self._authority.end()
            self._log.note(Reception(time_s=self._now_s(), kind="Withdraw", episode=self._episode))
        self._log.flush()

    def handle(self, request: Request) -> Reply:
        """Carry out one request, or refuse it."""
        try:
            reply = self._carry_out(request)
        except (ExecutionError, DefinitionError) as error:
            code = error.code if isinstance(error, ExecutionError) else error.problems[0].code
            reply = Refused(code, str(error))
        self._note(request, reply)
        return reply

    def _carry_out(self, request: Request) -> Reply:
        match request:
            case Command():
                return self._apply(request)
            case Observe():
                return self._observe()
            case Halt():
                return self._authority.check(request.session, request.epoch) or self._halt()
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
            case SaveModel():
                self._get_physics().save(Path(request.folder))
                return Ack()
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
            q_min_rad=tuple(ranges[:, 0].tolist()),
            q_max_rad=tuple(ranges[:, 1].tolist()),
            observations=profile.observations,
            actions=profile.actions,
            cameras=cameras,
            mode="lockstep",
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
        spec = read_scene(self._library.get_scene(request.scene))
        physics = Physics(self._profile, self._folder, spec, request.seed)
        self._faults = self._make_faults(request.episode, request.seed)
        physics.start(spec.settle_s)
        if request.state is not None:
            physics.restore(request.state)
        self._physics, self._episode, self._scene = physics, request.episode, scene
        self._hold(physics.q_rad if request.state is not None else np.array(self._profile.arm.home_rad))
        self._log.note(Reception(time_s=physics.time_s, kind="state_write", episode=self._episode))
        return Loaded(request.episode, physics.model_sha256)

    def _begin(self, request: Begin) -> Reply:
        self._get_physics()
        refused = self._authority.begin(request.session, request.epoch)
        if refused is None:
            self._struck = list(self._faults.on_session(request.session))
        return refused or Ack()

    def _end(self) -> Reply:
        self._authority.end()
        self._log.flush()
        return Ended(self._now_s(), tuple(self._struck))

    def _apply(self, command: Command) -> Reply:
        physics = self._get_physics()
        refused = self._find_malformation(command, physics) or self._authority.admit(command, physics.time_s)
        if refused is not None:
            return refused
        controls = physics.data.ctrl
        for row in physics.compute_controls(command.q_rad, command.qd_rad_s, command.gripper_width_m):
            controls[:] = row
            self._step(physics)
        self._held, self._width_m = command.q_rad[-1], float(command.gripper_width_m[-1])
        return self._report(physics)

    def _find_malformation(self, command: Command, physics: Physics) -> Refused | None:
        """The target's own limits; they hold whatever stands upstream."""
        steps, n = count_steps(self._profile), len(self._profile.arm.joints)
        q, qd, width = command.q_rad, command.qd_rad_s, command.gripper_width_m
        if (q.shape, qd.shape, width.shape) != ((steps, n), (steps, n), (steps,)):
            return Refused("MALFORMED", f"shapes {q.shape}, {qd.shape}, {width.shape}; expected {steps} rows of {n}")
        if not np.isfinite(q.sum() + qd.sum() + width.sum()):  # NaN and infinity survive a sum
            return Refused("MALFORMED", "a set-point is not finite")
        low, high = physics.q_range
        if (q < low).any() or (q > high).any():
            return Refused("TARGET_LIMIT", "a set-point leaves the range of its joint")
        rows = np.vstack((self._held, q))
        if (np.abs(rows[1:] - rows[:-1]) > self._jump_max_rad).any():
            return Refused("TARGET_LIMIT", "set-points jump faster than the joints can follow")
        if width.min() < -ROUNDING or width.max() > self._profile.gripper.max_width_m + ROUNDING:
            return Refused("TARGET_LIMIT", f"opening outside 0..{self._profile.gripper.max_width_m} m")
        return None

    def _halt(self) -> Step:
        """Decelerate within the joint limits, then hold; generated here, no command."""
        physics, dt = self._get_physics(), self._profile.physics_step_s
        brake = np.array(self._profile.arm.acceleration_rad_s2) * dt
        q, qd = physics.q_rad, physics.qd_rad_s
        for _ in range(round(HALT_MAX_S / dt)):
            qd = np.sign(qd) * np.maximum(np.abs(qd) - brake, 0.0)
            q = np.clip(q + qd * dt, *physics.q_range)
            physics.set_servos(q, qd, self._width_m)
            self._step(physics)
            if not qd.any() and np.abs(physics.qd_rad_s).max() < REST_RAD_S:
                break
        self._held = q
        return self._report(physics)

    def _settle(self, duration_s: float) -> Step:
        physics = self._get_physics()
        physics.set_servos(self._held, np.zeros_like(self._held), self._width_m)
        for _ in range(round(min(duration_s, 60.0) / self._profile.physics_step_s)):
            self._step(physics)
        return self._report(physics)

    def _step(self, physics: Physics) -> None:
        self._struck += self._faults.act(physics)
        physics.step()

    def _hold(self, q_rad: Array) -> None:
        physics = self._get_physics()
        self._held = np.clip(q_rad, *physics.q_range)
        self._width_m = float(np.clip(physics.gripper_width_m, 0.0, self._profile.gripper.max_width_m))

    def _report(self, physics: Physics) -> Step:
        physics.look()
        touching = physics.find_touching()
        return Step(
            time_s=physics.time_s,
            target=physics.read_target(touching),
            tracking_error_rad=float(np.abs(physics.q_rad - self._held).max()),
            touching=tuple(touching),
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

    def _render(self, request: Render) -> Picture:
        physics = self._get_physics()
        physics.look()
        return render_png(physics.model, physics.seen, request.camera, request.width, request.height)

    def _get_physics(self) -> Physics:
        if self._physics is None:
            raise ExecutionError("NO_SCENE", "no scene is loaded; send LoadScene first")
        return self._physics

    def _now_s(self) -> float:
        return self._physics.time_s if self._physics is not None else 0.0

    def _note(self, request: Request, reply: Reply) -> None:
        if isinstance(request, Observe | Describe | Render | SaveModel | Shutdown):
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
