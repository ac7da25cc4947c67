"""A target without physics (`kind: debug`): it is where the last command put it, and every movable body rides on it."""

import msgspec
import numpy as np
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays
from phyagentos.protocol.world.environment import Entity, Pose, Region, Shape, TargetState
from phyagentos.protocol.world.idealisations import Aspect, Idealisation
from phyagentos.protocol.world.scenes import Body
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetDriver

END_STOP = 1e9  # no end stops; safety.yaml sets the limits


class DebugDriver(TargetDriver):
    """One debug target, one scene at a time.

    The tool centre point is above the mount by the first joint's position [m], without rotation.
    """

    def __init__(self, profile: TargetProfile, library: Library) -> None:
        self.profile, self._library = profile, library
        self._steps = round(profile.control_period_s / profile.physics_step_s)
        self._fixed: tuple[Entity, ...] = ()
        self._riding: tuple[Entity, ...] = ()
        self._regions: tuple[Region, ...] = ()
        self._q = np.array(profile.arm.home_rad, dtype=np.float64)
        self._width_m = profile.gripper.max_width_m
        self._tick = 0

    @property
    @override
    def time_s(self) -> float:
        return self._tick * self.profile.physics_step_s

    @property
    @override
    def is_moving(self) -> bool:
        return False

    @override
    def describe(self) -> wire.Description:
        profile, n = self.profile, len(self.profile.arm.joints)
        return self.describe_profile(
            q_min_rad=(-END_STOP,) * n,
            q_max_rad=(END_STOP,) * n,
            kinematics=wire.Kinematics(
                axes=((0.0, 0.0, 1.0), *((0.0, 0.0, 0.0),) * (n - 1)),
                anchors_m=(profile.mount_position_m,) * n,
                tcp_m=profile.mount_position_m,
                slides=(True,) * n,
            ),
            gripper_force_n=0.0,
            driver="debug",
            idealisations=(Idealisation(Aspect.PHYSICS),),
            ground_truth=True,
        )

    @override
    def load(self, request: wire.LoadScene) -> wire.Loaded:
        tick, q = 0, np.array(self.profile.arm.home_rad, dtype=np.float64)
        if request.snapshot:
            state = decode_arrays(request.snapshot).get("state", np.empty(0))
            if state.shape != (1 + q.size,) or not np.isfinite(state).all():
                raise ExecutionError("MALFORMED", f"a state of shape {state.shape}; expected a tick and the joints")
            tick, q = int(state[0]), state[1:]
        spec = read_placed(self._library, request.scene)
        entities = [(_make_entity(name, body), body.fixed) for name, body in spec.bodies.items()]
        self._fixed = tuple(entity for entity, fixed in entities if fixed)
        self._riding = tuple(entity for entity, fixed in entities if not fixed)
        self._regions = tuple(
            Region(name=name, pose=Pose(region.center_m), half_m=region.half_m) for name, region in spec.regions.items()
        )
        self._tick, self._q = tick, q
        return wire.Loaded(request.episode, "")

    @override
    def apply(self, command: wire.Command) -> str:
        self.check_set_points(command)
        self._q, self._width_m = np.array(command.q_rad[-1], dtype=np.float64), float(command.gripper_width_m[-1])
        self._tick += self._steps
        return ""

    @override
    def hold(self, duration_s: float) -> None:
        self._tick += round(duration_s / self.profile.physics_step_s)

    @override
    def halt(self, category: int = 2) -> None:
        """The target is always at rest."""

    @override
    def report(self) -> wire.Step:
        return wire.Step(time_s=self.time_s, target=self._read_target(), tracking_error_rad=0.0)

    def _read_target(self) -> TargetState:
        x, y, z = self.profile.mount_position_m
        q = tuple(self._q.tolist())
        return TargetState(q_rad=q, qd_rad_s=(0.0,) * len(q), gripper_width_m=self._width_m, tcp=Pose((x, y, z + q[0])))

    @override
    def observe(self, *, truth: bool) -> wire.Observation:
        target, now_s = self._read_target(), self.time_s
        if not truth:
            return wire.Observation(time_s=now_s, target=target)
        seen = [(entity, entity.pose) for entity in self._fixed] + [(entity, target.tcp) for entity in self._riding]
        return wire.Observation(
            time_s=now_s,
            target=target,
            entities=tuple(
                msgspec.structs.replace(entity, pose=pose, observed_at_s=now_s, source="debug") for entity, pose in seen
            ),
            regions=self._regions,
        )

    @override
    def snapshot(self) -> wire.Artefact:
        """NPZ as of a simulation: `state` (the tick, then the joints), `time`, `qpos`, `qvel` and `act`."""
        arrays = {
            "state": np.array((self._tick, *self._q.tolist()), dtype=np.float64),
            "time": np.asarray(self.time_s, dtype=np.float64),
            "qpos": self._q,
            "qvel": np.zeros(self._q.size),
            "act": np.empty(0),
        }
        return wire.Artefact(wire.NPZ, encode_arrays(arrays))


def _make_entity(name: str, body: Body) -> Entity:
    """A body of the scene at its fixed place, without randomness."""
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
