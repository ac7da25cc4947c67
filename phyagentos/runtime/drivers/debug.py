"""A target without physics, in memory: it stands where the last command put it, and every movable body rides on it.

Upstream: `server`, or a test. It is what `kind: debug` in a target.yaml gives: the same wire, authority and receive
log as any other target, so that everything around a robot can be tried, tested and measured without one.
"""

import math

import numpy as np

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity, Pose, Region, Shape, TargetState
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.authority import Authority
from phyagentos.runtime.targets.receive_log import STATE_WRITE, UNTOLD, ReceiveLog, Reception

SETTLE_MAX_S = 60.0  # as long as a simulated target allows
END_STOP = 1e9  # it has no end stops; safety.yaml sets the limits
_SILENT = (wire.Observe, wire.Describe, wire.Render, wire.Capture, wire.SaveModel, wire.Shutdown)
_NEW = (wire.Begin, wire.Command)  # what is refused while it cannot be told


class DebugDriver:
    """One debug target, one scene at a time.

    The tool centre point stands above the mount by the first joint's position [m], without turning.

    Args:
        profile: The target; its `model` is not read.
        library: Where scenes are found.
        log: The receive log.
    """

    def __init__(self, profile: TargetProfile, library: Library, log: ReceiveLog) -> None:
        self._profile, self._library, self._log = profile, library, log
        self._steps = round(profile.control_period_s / profile.physics_step_s)
        self._authority = Authority()
        self._episode = ""
        self._scene: tuple[str, int] = ("", 0)
        self._fixed: tuple[Entity, ...] = ()
        self._riding: tuple[Entity, ...] = ()
        self._regions: tuple[Region, ...] = ()
        self._q = np.array(profile.arm.home_rad, dtype=np.float64)
        self._width_m = profile.gripper.max_width_m
        self._tick = 0

    def close(self) -> None:
        """Let go of the log."""
        self._log.close()

    def withdraw(self) -> None:
        """Nobody is connected any more: authority ends."""
        if self._authority.session:
            self._authority.end()
            self._log.stamp()
            self._log.note(Reception(time_s=self._now_s(), kind="Withdraw", episode=self._episode))

    def handle(self, request: wire.Request) -> wire.Reply:
        """Carry out one request, or refuse it."""
        is_told = not isinstance(request, _SILENT)
        if is_told:
            self._log.stamp()
        try:
            reply = self._refuse_untold(request) or self._carry_out(request)
        except DefinitionError as error:
            reply = wire.Refused(error.problems[0].code, str(error))
        if is_told:
            self._note(request, reply)
        return reply

    def _refuse_untold(self, request: wire.Request) -> wire.Refused | None:
        is_untold = isinstance(request, _NEW) and self._log.is_behind
        return wire.Refused("LOG_UNWRITABLE", UNTOLD) if is_untold else None

    def _carry_out(self, request: wire.Request) -> wire.Reply:
        match request:
            case wire.Observe():
                return self._observe()
            case wire.Describe():
                return self._describe()
            case wire.LoadScene():
                return self._load(request)
            case wire.Render():
                return wire.Picture(b"", "a debug target has no cameras")
            case wire.Capture():
                return wire.Frames(())
            case wire.Begin():
                return self._authority.begin(request.session, request.epoch) or wire.Ack()
            case wire.SaveModel() | wire.Shutdown():
                return wire.Ack()
        return self._authority.check(request.session, request.epoch) or self._act(request)

    def _act(self, request: wire.Command | wire.Halt | wire.Settle | wire.End) -> wire.Reply:
        """What only the session in authority may ask for."""
        match request:
            case wire.Command():
                return self._apply(request)
            case wire.Halt(category=1):
                self._authority.stop("DRIVES_OFF")
            case wire.Settle():
                if not 0.0 <= request.duration_s <= SETTLE_MAX_S:  # also when it is NaN
                    return wire.Refused("MALFORMED", f"a settling time of {request.duration_s} s")
                self._tick += round(request.duration_s / self._profile.physics_step_s)
            case wire.End():
                self._authority.end()
                return wire.Ended(self._now_s(), ())
        return self._report()

    def _describe(self) -> wire.Description:
        profile, n = self._profile, len(self._profile.arm.joints)
        return wire.Description(
            target=profile.target,
            n_joints=n,
            steps_per_command=self._steps,
            physics_step_s=profile.physics_step_s,
            q_min_rad=(-END_STOP,) * n,
            q_max_rad=(END_STOP,) * n,
            observations=profile.observations,
            actions=profile.actions,
            cameras=(),
            mode="lockstep",
            kinematics=wire.Kinematics(
                axes=((0.0, 0.0, 1.0), *((0.0, 0.0, 0.0),) * (n - 1)),
                anchors_m=(profile.mount_position_m,) * n,
                tcp_m=profile.mount_position_m,
                slides=(True,) * n,
            ),
            gripper_force_n=0.0,  # what it holds only rides along
            joints=profile.arm.joints,
            version=wire.WIRE_VERSION,
        )

    def _load(self, request: wire.LoadScene) -> wire.Reply:
        if self._authority.session:
            holder = self._authority.session
            return wire.Refused("NO_AUTHORITY", f"{holder} has authority; scenes are loaded between sessions")
        scene = (request.scene, request.seed)
        if request.episode == self._episode and request.state is None:
            if scene != self._scene:
                return wire.Refused("EPISODE_CONFLICT", f"episode {request.episode} is {self._scene}, not {scene}")
            return wire.Loaded(request.episode, "")
        if self._episode and not request.may_reset:
            message = f"episode {request.episode} would end episode {self._episode}, and its contract permits no reset"
            return wire.Refused("RESET_FORBIDDEN", message)
        if request.state is not None and not (
            request.state.shape == (1 + self._q.size,) and np.isfinite(request.state).all()
        ):
            return wire.Refused("MALFORMED", f"a state of shape {request.state.shape}; expected a tick and the joints")
        self._place(read_scene(self._library.get_scene(request.scene)))
        self._tick, self._q = 0, np.array(self._profile.arm.home_rad, dtype=np.float64)
        if request.state is not None:
            self._tick, self._q = int(request.state[0]), np.array(request.state[1:])
        self._episode, self._scene = request.episode, scene
        self._log.note(Reception(time_s=self._now_s(), kind=STATE_WRITE, episode=self._episode))
        return wire.Loaded(request.episode, "")

    def _place(self, spec: SceneSpec) -> None:
        """The bodies of a scene: what is fixed stands where the scene puts it, what is not rides on the target."""
        entities = [(_make_entity(name, body), body.fixed) for name, body in spec.bodies.items()]
        self._fixed = tuple(entity for entity, fixed in entities if fixed)
        self._riding = tuple(entity for entity, fixed in entities if not fixed)
        self._regions = tuple(
            Region(name=name, pose=Pose(region.center_m), half_m=region.half_m) for name, region in spec.regions.items()
        )

    def _apply(self, command: wire.Command) -> wire.Reply:
        shape = (self._steps, self._q.size)
        arrays = (command.q_rad, command.qd_rad_s, command.gripper_width_m)
        if tuple(array.shape for array in arrays) != (shape, shape, shape[:1]):
            return wire.Refused(
                "MALFORMED", f"q_rad of shape {command.q_rad.shape}; expected {shape}, and others like it"
            )
        if not all(math.isfinite(value) for array in arrays for value in array.ravel().tolist()):
            return wire.Refused("MALFORMED", "a set-point is not finite")
        refused = self._authority.admit(command, self._now_s())
        if refused is not None:
            return refused
        self._q, self._width_m = np.array(command.q_rad[-1], dtype=np.float64), float(command.gripper_width_m[-1])
        self._tick += self._steps
        return self._report()

    def _read_target(self) -> TargetState:
        x, y, z = self._profile.mount_position_m
        q = tuple(self._q.tolist())
        return TargetState(
            q_rad=q,
            qd_rad_s=(0.0,) * len(q),
            gripper_width_m=self._width_m,
            tcp=Pose((x, y, z + q[0])),
        )

    def _report(self) -> wire.Step:
        return wire.Step(time_s=self._now_s(), target=self._read_target(), tracking_error_rad=0.0)

    def _observe(self) -> wire.Observation:
        target, now_s = self._read_target(), self._now_s()
        seen = [(entity, entity.pose) for entity in self._fixed] + [(entity, target.tcp) for entity in self._riding]
        return wire.Observation(
            time_s=now_s,
            target=target,
            state=np.array((self._tick, *target.q_rad), dtype=np.float64),
            qpos=self._q,
            qvel=np.zeros(self._q.size),
            act=np.empty(0),
            entities=tuple(
                Entity(
                    name=entity.name,
                    kind=entity.kind,
                    pose=pose,
                    movable=entity.movable,
                    shapes=entity.shapes,
                    color=entity.color,
                    observed_at_s=now_s,
                    source="debug",
                )
                for entity, pose in seen
            ),
            regions=self._regions,
        )

    def _now_s(self) -> float:
        return self._tick * self._profile.physics_step_s

    def _note(self, request: wire.Request, reply: wire.Reply) -> None:
        self._log.note(
            Reception(
                time_s=self._now_s(),
                kind=type(request).__name__,
                episode=self._episode,
                session=getattr(request, "session", ""),
                epoch=getattr(request, "epoch", 0),
                sequence=getattr(request, "sequence", 0),
                accepted=not isinstance(reply, wire.Refused),
                code=reply.code if isinstance(reply, wire.Refused) else "",
            )
        )


def _make_entity(name: str, body: Body) -> Entity:
    """A body as the scene describes it, at its fixed place; nothing is drawn at random."""
    shapes = tuple(
        Shape(kind=solid.kind, size_m=solid.size_m, pose=Pose(solid.position_m))
        for solid in body.shapes
        if not solid.decor
    )
    return Entity(
        name=name,
        kind=body.kind,
        pose=Pose(body.place.position_m),
        movable=not body.fixed,
        shapes=shapes,
        color=body.color,
    )
