"""Targets: profiles in, TARGETS.md out. Paper section 3.5.

A profile states what a target is and can do, with the datasheet's limits for planning; safety.yaml holds what the guard
enforces.
"""

from collections import Counter
from collections.abc import Collection
from enum import StrEnum
from typing import Literal, Self

import pydantic
from typing_extensions import override

from phyagentos.errors import Problem
from phyagentos.protocol.documents.document import DocumentFormat
from phyagentos.protocol.documents.enclosure import leads_out
from phyagentos.protocol.documents.schema import Authored, Box, NotNegative, Positive, Quaternion, Span, misfit
from phyagentos.protocol.settings.operations import SESSION_OPERATIONS, Operation
from phyagentos.protocol.world.friction import Surface

DRIVER_OF_KIND = {"simulation": "mujoco", "debug": "debug"}  # where a profile names none; a real robot has no default
MODEL_SOURCES = ("menagerie", "package", "models")  # before the colon of a model that is not beside its profile
SHARING = "mujoco"  # the driver whose world holds several targets
SERVED = "remote"  # the driver of a target whose world is served elsewhere
BASE_JOINTS = ("base_x", "base_y", "base_yaw")  # commanded before those of the arm
HAND = "hand/"  # begins the names of a mounted hand
FINGERTIP_CLEAR_M = 0.006  # that the fingertips keep from what an object stands on
YAW_MAX_RAD = 3.1  # a heading is measured between half a turn to either side

Triple = tuple[float, float, float]


class Frame(Authored):
    """A place on a body of the model.

    Attributes:
        body: Its name.
        position_m: In the frame of the body [m].
        quaternion_wxyz: In the frame of the body.
    """

    body: str
    position_m: Triple = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)


class PadBox(Frame):
    """A box that a finger grips with, added to the model.

    Attributes:
        name: Of the geom.
        half_m: Half of its sides [m].
    """

    name: str
    half_m: Triple


class XacroArguments(Authored):
    """Values of a xacro file's arguments by their names."""

    model_config = pydantic.ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, str | int | float | bool]

    def as_texts(self) -> dict[str, str]:
        """The values as xacro takes them."""
        return {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in self}


class Hand(Authored):
    """A model that the arm's flange carries; its names begin with `hand/`.

    Attributes:
        model: As that of the profile.
        arguments: As those of the profile.
        at: The place on the arm where its base is put.
    """

    model: str
    arguments: XacroArguments = XacroArguments.model_validate({})
    at: Frame


class ScenePlacement(Authored):
    """How scenes are placed for a robot that reaches less or more than those they were made for.

    Attributes:
        scale: Of places, and of what stands fixed on the table.
        move_m: Of everything, after that [m].
    """

    scale: float = pydantic.Field(default=1.0, ge=0.5, le=1.2)
    move_m: Triple = (0.0, 0.0, 0.0)


class DriverSettings(Authored):
    """What one driver needs of its target, by names of its own: texts, numbers and lists of numbers."""

    model_config = pydantic.ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, str | int | float | tuple[int | float, ...]]


class Posture(Authored):
    """Positions of joints by their names [rad, or m]."""

    model_config = pydantic.ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]


class Ranges(Authored):
    """Least and greatest positions of joints by their names [rad, or m]."""

    model_config = pydantic.ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Span]


class OmniWheels(Authored):
    """Wheels with passive rollers around their rims, added to the model around the joints of the base.

    Attributes:
        links: Bodies of the model whose solids they replace; the meshes of these need not be here.
        radius_m: Of the wheel, its rollers included [m].
        offset_m: Of the middle of the wheel, from its joint along the axis of that [m].
        rollers: Around one wheel.
        roller_radius_m: Of a roller [m].
    """

    links: tuple[str, ...]
    radius_m: float = pydantic.Field(gt=0.0)
    offset_m: float = 0.0
    rollers: int = pydantic.Field(default=20, ge=8)
    roller_radius_m: float = pydantic.Field(default=0.011, gt=0.0)


class Base(Authored):
    """A body that drives or walks. In the simulation nothing holds it but what it stands on.

    The arm's first joints are then its pose `base_x`, `base_y` [m] and `base_yaw` [rad] in the world, its speeds are in
    m/s and rad/s, and its servo values are zero. Other lists have one entry for each of `joints`.

    Attributes:
        kind: What moves it, by its name in `runtime.drivers.mujoco.locomotion`.
        body: Of the model, held by nothing; `mount_position_m` says how high its frame stands on the ground.
        pose_min: Least `base_x`, `base_y`, `base_yaw`.
        pose_max: Greatest ones; it never turns past its back.
        joints: Names of what it drives: wheels, or legs.
        torque_nm: Largest torque of each of these [N m].
        stiffness_nm_rad: Position gain of each [N m/rad]; with zero it is driven by velocity.
        damping_nms_rad: Velocity gain of each [N m s/rad]; with both zero it is driven by torque.
        posture_rad: Of any joints of the model at rest, by name; those that nothing drives stay so, zero if unnamed.
        mass_kg: Of the body alone, where its model has no sensible one [kg].
        wheels: Of a base that drives on such.
        sole_surface: What the solid spheres are made of that its legs stand on; without it they are links like others.
        settings: What its kind needs besides, by its own names.
    """

    kind: str
    body: str
    pose_min: Triple = (-3.0, -3.0, -3.1)
    pose_max: Triple = (3.0, 3.0, 3.1)
    joints: tuple[str, ...] = ()
    torque_nm: tuple[NotNegative, ...] = ()
    stiffness_nm_rad: tuple[NotNegative, ...] = ()
    damping_nms_rad: tuple[NotNegative, ...] = ()
    posture_rad: Posture = Posture.model_validate({})
    mass_kg: float | None = pydantic.Field(default=None, gt=0.0)
    wheels: OmniWheels | None = None
    sole_surface: Surface | None = None
    settings: DriverSettings = DriverSettings.model_validate({})

    @pydantic.model_validator(mode="after")
    def _check_lists(self) -> Self:
        lists = (self.torque_nm, self.stiffness_nm_rad, self.damping_nms_rad)
        if any(len(each) != len(self.joints) for each in lists):
            raise ValueError(f"torque, stiffness and damping of a base need {len(self.joints)} values, one per joint")
        if max(-self.pose_min[2], self.pose_max[2]) > YAW_MAX_RAD:
            raise ValueError(f"base_yaw is kept within {YAW_MAX_RAD} rad to either side")
        return self


WRIST_JOINTS = 3


class Arm(Authored):
    """Joints and servo of an arm; all lists have one entry per joint, in chain order.

    Attributes:
        joints: Names in the model.
        home_rad: Posture of rest [rad].
        velocity_rad_s: Largest velocity that is planned [rad/s].
        acceleration_rad_s2: Largest acceleration that is planned [rad/s^2].
        jerk_rad_s3: Largest jerk that is planned [rad/s^3].
        torque_nm: Largest torque of the servo [N m].
        stiffness_nm_rad: Position gain of the servo [N m/rad].
        damping_nms_rad: Velocity gain of the servo [N m s/rad].
        armature_kg_m2: Inertia of its motors behind their gears, where the model has too little for light links.
        payload_kg: Heaviest load, the hand included [kg]; an arm without this value carries nothing.
        position_noise_rad: Standard deviation of measured joint positions [rad].
        velocity_noise_rad_s: Standard deviation of measured joint velocities [rad/s].
        state_delay_s: Age of what is measured of the joints [s].
        wrist_joints: Last joints, whose links carry the hand: the search does not test them against what is held.
    """

    joints: tuple[str, ...]
    home_rad: tuple[float, ...]
    velocity_rad_s: tuple[Positive, ...]
    acceleration_rad_s2: tuple[Positive, ...]
    jerk_rad_s3: tuple[Positive, ...]
    torque_nm: tuple[NotNegative, ...]
    stiffness_nm_rad: tuple[NotNegative, ...]
    damping_nms_rad: tuple[NotNegative, ...]
    armature_kg_m2: float = pydantic.Field(default=0.0, ge=0.0)
    payload_kg: float = pydantic.Field(default=0.0, ge=0.0, le=500.0)
    position_noise_rad: float = pydantic.Field(default=0.0, ge=0.0)
    velocity_noise_rad_s: float = pydantic.Field(default=0.0, ge=0.0)
    state_delay_s: float = pydantic.Field(default=0.0, ge=0.0)
    wrist_joints: int = pydantic.Field(default=WRIST_JOINTS, ge=1)

    @pydantic.model_validator(mode="after")
    def _check_joints(self) -> Self:
        if twice := [each for index, each in enumerate(self.joints) if each in self.joints[:index]]:
            raise misfit("joints", "each joint once", f"{twice[0]!r} stands twice.")
        if self.wrist_joints > max(count := len(self.joints), WRIST_JOINTS):  # what a registry repeats is no choice
            raise misfit("wrist_joints", f"at most {count}, the joints of the arm", f"Write {count} or less.")
        return self


NO_ARM = Arm(
    joints=(),
    home_rad=(),
    velocity_rad_s=(),
    acceleration_rad_s2=(),
    jerk_rad_s3=(),
    torque_nm=(),
    stiffness_nm_rad=(),
    damping_nms_rad=(),
)


class Gripper(Authored):
    """A gripper: `width_m` is the opening between its two pads, one set-point for all fingers.

    Attributes:
        joints: What its drive moves, names in the model.
        travel: Share of each joint in the drive; without it each slides by its share of the opening. Where joints turn
            or are coupled, the drive is calibrated in the model: see `runtime.models.hand`.
        pads: Geoms that touch.
        pad_boxes: Pads that the model lacks.
        pad_surface: What the pads are made of; without it they have the model's own friction.
        max_width_m: Widest opening [m].
        stiffness_n_m: Position gain of the servo [N/m].
        damping_ns_m: Velocity gain of the servo [N s/m].
        force_n: Largest force of one finger [N].
        mass_kg: Mass of the hand, which is a part of the arm's load [kg].
        speed_m_s: Speed at which its drive changes the opening [m/s]; that of one finger is half of it.
        close_time_s: Time the drive is given to build up its grip [s].
        palm_depth_m: How far an object may reach above the tool centre point before it meets the palm [m].
        palm_height_m: How far the palm stands above the fingertips [m].
        fingertip_m: Least height of the tool centre point above a support that the fingertips must not touch [m]: its
            height above the fingertips, and `FINGERTIP_CLEAR_M`.
        grasp_reach_m: How far from the tool centre point the fingers hold an object, beyond its own size [m].
    """

    joints: tuple[str, ...]
    travel: tuple[float, ...] = ()
    pads: tuple[str, ...]
    pad_boxes: tuple[PadBox, ...] = ()
    pad_surface: Surface | None = None
    max_width_m: float = pydantic.Field(ge=0.0, le=1.0)
    stiffness_n_m: NotNegative
    damping_ns_m: NotNegative
    force_n: NotNegative
    mass_kg: float = pydantic.Field(default=0.0, ge=0.0)
    speed_m_s: float = pydantic.Field(default=0.1, gt=0.0)
    close_time_s: float = pydantic.Field(default=0.4, ge=0.0, le=10.0)
    palm_depth_m: NotNegative = 0.02
    palm_height_m: NotNegative = 0.055
    fingertip_m: NotNegative = 0.016
    grasp_reach_m: NotNegative = 0.03

    @property
    def squeeze_m(self) -> float:
        """How far beyond what it holds the drive's set-point is where it presses with its full force [m]."""
        return self.force_n / self.stiffness_n_m


NO_GRIPPER = Gripper(joints=(), pads=(), max_width_m=0.0, stiffness_n_m=0.0, damping_ns_m=0.0, force_n=0.0)


class TargetProfile(Authored):
    """One target of TARGETS.md.

    Attributes:
        target: Its name; also the folder's.
        description: One sentence for people.
        kind: `debug` has no physics: the target takes each commanded posture at once (see `runtime.drivers.debug`).
        driver: What moves it, by its name in the registry of drivers; empty for the one of its kind: `mujoco` for
            `simulation`, `debug` for `debug`, none for `real_robot`.
        endpoint: Where the driver finds its target: `ws://127.0.0.1:7000` for `remote`, or a bus (`/dev/ttyACM0`).
        silence_max_s: How long the driver `remote` waits for a sign of its target before it is lost [s].
        settings: What the driver needs besides, by its own names.
        deterministic: Whether the driver's own snapshot and the same calls give the same bits, so that sessions can be
            run again; one that leaves its state as NPZ needs no such word. In lockstep it begins its next session when
            the agent has acted on the last one, so that a whole goal is repeated.
        world: Name of the simulated world that it shares with the other targets of this name; empty for one of its own.
        end_effector: What its flange carries: a gripper with an `opening`, a `suction` cup, or `none`.
        model: MJCF or URDF file, relative to the profile or `SOURCE:PATH`, see `runtime.models.sources`; none for
            `debug`.
        arguments: Values of a xacro file's arguments.
        hand: What is mounted on the arm, where the model has none.
        parked_rad: Where joints of the model stand still that are none of the target's, by name; zero if unnamed.
        ranges: Of joints that turn without end in the model, and not in reality.
        embodiment: What it is (`arm`).
        tcp: Site of the tool centre point; z approaches, y is the closing axis.
        tool: Where this site is; none where the model has it.
        placement: How scenes are placed for it.
        mount_position_m: Where its base stands in the world [m].
        mount_quaternion_wxyz: How its base stands in the world.
        stands_on_column: Whether a solid column carries its base from the level of the table's top up.
        control_period_s: Length of one command [s]; a whole number of physics steps.
        physics_step_s: One step of the simulation [s].
        workspace_m: Box that the target itself keeps its tool centre point in, least and greatest corner, world frame;
            none for no such limit. Wider than what safety.yaml allows.
        grasp_band_m: Horizontal distances from its base between which it can take hold of objects [m].
        contact_force_n: Beyond this force on any part of it the target stops by itself [N].
        force_bias_n: Greatest constant error of a contact force that is estimated from joint torques [N].
        force_noise_n: Standard deviation of that estimate [N].
        base: What it drives or walks with; none where it is fixed.
        arm: Its joints; left out for a target that has none and acts by procedures alone.
        postures: Postures that it can be asked for by name, one value for each joint of `arm` [rad], without the pose
            of a base.
        gripper: Its hand; left out where the end effector does not open.
        observations: What it offers; a skill's `needs.observations` are matched against these names.
        actions: What it takes; a skill's `needs.actions` are matched against these names.
        capabilities: What else a skill may need (`manipulation`).
        operations: What it can be asked to do by a session that has authority.
    """

    target: str = pydantic.Field(pattern=r"^[a-z][a-z0-9_]*$")
    description: str
    kind: Literal["simulation", "real_robot", "debug"] = "simulation"
    embodiment: str = "arm"
    model: str = ""
    arguments: XacroArguments = XacroArguments.model_validate({})
    hand: Hand | None = None
    parked_rad: Posture = Posture.model_validate({})
    ranges: Ranges = Ranges.model_validate({})
    driver: str = ""
    endpoint: str = ""
    silence_max_s: float = pydantic.Field(default=10.0, gt=0.0)
    settings: DriverSettings = DriverSettings.model_validate({})
    deterministic: bool = False
    world: str = pydantic.Field(default="", pattern=r"^([a-z][a-z0-9_]*)?$")
    end_effector: Literal["opening", "suction", "none"] = "opening"
    tcp: str = "tcp"
    tool: Frame | None = None
    placement: ScenePlacement = ScenePlacement()
    mount_position_m: Triple = (0.0, 0.0, 0.0)
    mount_quaternion_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    stands_on_column: bool = False
    control_period_s: float = pydantic.Field(default=0.02, gt=0.0, le=1.0)
    physics_step_s: float = pydantic.Field(default=0.002, gt=0.0, le=1.0)
    workspace_m: Box | None = None
    grasp_band_m: Span = (0.34, 0.66)
    contact_force_n: Positive = 100.0
    force_bias_n: float = pydantic.Field(default=0.0, ge=0.0)
    force_noise_n: float = pydantic.Field(default=0.0, ge=0.0)
    base: Base | None = None
    arm: Arm = NO_ARM
    postures: dict[str, tuple[float, ...]] = {}
    gripper: Gripper = NO_GRIPPER
    observations: tuple[str, ...] = ()
    actions: tuple[str, ...] = ()
    capabilities: tuple[str, ...] = ()
    operations: tuple[Operation, ...] = SESSION_OPERATIONS

    @override
    def __hash__(self) -> int:
        return hash(self.target)  # its mapping has no hash; that two are equal is asked of every field

    @pydantic.model_validator(mode="after")
    def _check_end_effector(self) -> Self:
        if leads_out(self.model, self.target):
            raise ValueError(
                f"model {self.model!r} leads out of robots/; keep it with the target, and what it includes"
            )
        if (self.gripper.max_width_m > 0.0) != (self.end_effector == "opening"):
            expected = "a gripper that opens" if self.end_effector == "opening" else "no gripper"
            raise misfit("end_effector", f"one that fits the block `gripper`: {self.end_effector!r} needs {expected}")
        if self.gripper.joints and not self.gripper.force_n > 0.0:
            raise misfit("gripper.force_n", "a force greater than 0, to close with", "Write it in newtons.")
        return self

    @pydantic.model_validator(mode="after")
    def _check_base(self) -> Self:
        if self.base is not None and (self.arm.joints[:3] != BASE_JOINTS or any(self.mount_position_m[:2])):
            expected = f"{', '.join(BASE_JOINTS)} as its first joints, and a mount at x, y = 0"
            raise ValueError(f"a target with a base needs {expected}")
        return self

    @property
    def servoed(self) -> slice:
        """Which of the arm's joints have servos: all but the pose of a base."""
        return slice(0 if self.base is None else len(BASE_JOINTS), None)


def is_beside(model: str) -> bool:
    """Whether a model is a path beside its profile, rather than one of a source that may not be here."""
    return model.partition(":")[0] not in MODEL_SOURCES


def find_driver_name(profile: TargetProfile) -> str:
    """The driver that a profile names, or that of its kind; empty without one."""
    return profile.driver or DRIVER_OF_KIND.get(profile.kind, "")


def find_own_world(profile: TargetProfile) -> str:
    """The shared world that it is in here; empty for one of its own, and for one that is served elsewhere."""
    return profile.world if find_driver_name(profile) == SHARING else ""


def find_unshared(profiles: Collection[TargetProfile]) -> list[Problem]:
    """Targets that name the world of others although theirs is another one: `WORLD_CONFLICT`."""
    sizes = Counter(each.world for each in profiles if each.world)
    here = {find_own_world(each) for each in profiles}
    return [
        Problem(
            "WORLD_CONFLICT",
            f"{each.target}/target.yaml: world",
            f"driver {driver!r} of {each.target!r} in the shared world {each.world!r}",
            f"the driver {SHARING!r}, or a world of its own",
        )
        for each in profiles
        if sizes[each.world] > 1 and (driver := find_driver_name(each)) != (SHARING if each.world in here else SERVED)
    ]


class Health(StrEnum):
    """How the worker of a target is."""

    NOT_STARTED = "not_started"
    """No worker has run in this workspace."""
    READY = "ready"
    """Its process is alive; it waits or works."""
    SILENT = "silent"
    """Its process is alive and holds a session, but its heartbeat does not advance."""
    LOST = "lost"
    """Its process ended while the runtime was running."""
    STOPPED = "stopped"
    """The runtime has ended, and the worker with it."""


class TargetHealth(Authored):
    """The health of one target, as the runtime last saw it.

    Attributes:
        state: See `Health`.
        since: UTC wall time of the change; empty when it never started.
        session: What it held when it fell silent or was lost; empty otherwise.
    """

    state: Health = Health.NOT_STARTED
    since: str = ""
    session: str = ""


class RegisteredTarget(TargetProfile):
    """One block of TARGETS.md: the profile, and how the target is.

    Attributes:
        health: Written by the runtime, never by a person.
    """

    health: TargetHealth = TargetHealth()


TARGETS = DocumentFormat(
    name="targets",
    file="TARGETS.md",
    summary="Every target of a workspace: its profile, and how its worker is.",
    block=RegisteredTarget,
    key="target",
)
