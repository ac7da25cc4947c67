"""What is in the world: entities, relations, targets; ENVIRONMENT.md is its document. Paper section 4.1.

Poses are in the frame `world` (z up, metres, quaternions w x y z) unless a name shows another.
"""

from collections.abc import Iterable
from enum import StrEnum

import msgspec
from msgspec import UNSET, UnsetType

from phyagentos.errors import DefinitionError, format_names
from phyagentos.geometry import Pose as Pose  # noqa: PLC0414 - part of this vocabulary
from phyagentos.protocol.documents.document import DocumentFormat, read_document

REST_M_S = 0.02  # slower is contact noise
OPENS_AT, CLOSES_AT = 0.9, 0.1  # of a joint's travel
REST_S = 0.25  # an object that two looks so far apart show in one place rests
GRIP_N = 5.0  # a lighter pressure is the friction of the drive
CLOSED_M = 0.002  # fingers that are less apart press on each other
LIFTED_M = 0.02  # an object that was taken so far was lifted, not pressed
SURE = 0.65  # confidence below which a look does not show where an object is, or that it is this one
UNNAMED = "unknown"  # kind of an object outside the inventory
FRESH_S = 1.0  # older is not of now: the slowest camera that ships takes a picture every 0.1 s, and is late by less
AHEAD_S = 1.0  # touch updates a held object between two looks; nothing is seen later than that after its snapshot


class ShapeKind(StrEnum):
    """Primitive solids; sizes are half extents in metres, as in MuJoCo."""

    BOX = "box"
    """size = half x, half y, half z."""
    CYLINDER = "cylinder"
    """size = radius, half length; axis z."""
    CAPSULE = "capsule"
    """size = radius, half length of the cylinder part; axis z."""
    SPHERE = "sphere"
    """size = radius."""


class Status(StrEnum):
    """How an object is known now."""

    SEEN = "seen"
    """Its pose was measured at `observed_at_s`."""
    HELD = "held"
    """In a gripper: it is felt, and its pose follows the hand."""
    HIDDEN = "hidden"
    """Its last place cannot be seen now; it may still be there."""
    GONE = "gone"
    """Its last place is seen and empty, and it was not found elsewhere."""


class Shape(msgspec.Struct, frozen=True):
    """One primitive solid of an entity, posed in the entity's own frame.

    Attributes:
        kind: Which solid.
        size_m: Half extents (box), radius and half length (cylinder, capsule; axis z), radius (sphere) [m].
        pose: `entity_T_shape`.
    """

    kind: ShapeKind
    size_m: tuple[float, ...]
    pose: Pose = Pose()


class Interior(msgspec.Struct, frozen=True):
    """The box in which something counts as inside, in the entity's own frame.

    Attributes:
        center_m: (3,) centre [m].
        half_m: (3,) half extents [m].
    """

    center_m: tuple[float, float, float]
    half_m: tuple[float, float, float]


class Contents(msgspec.Struct, frozen=True):
    """Small, equal, nameless balls in a vessel.

    Attributes:
        least: So many are surely in it.
        most: More are surely not.
        observed_at_s: When that was so [s].
    """

    least: int
    most: int
    observed_at_s: float


class Mechanism(msgspec.Struct, frozen=True):
    """How an object with a joint opens.

    Attributes:
        kind: `slide` or `hinge`.
        axis: (3,) direction of opening, or of the hinge about which it opens, in the entity's frame.
        travel: From closed to open [m], or [rad] for a hinge.
        closed: `world_T_entity` when it is closed.
        anchor_m: (3,) a point of a hinge's axis, in the entity's frame [m].
        opens_at: Share of the travel from which it counts as open.
        closes_at: Share of the travel up to which it counts as closed.
    """

    kind: str
    axis: tuple[float, float, float]
    travel: float
    closed: Pose
    anchor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    opens_at: float = OPENS_AT
    closes_at: float = CLOSES_AT


class Entity(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An object in the world, as believed at `observed_at_s`.

    Attributes:
        name: Unique name (`red_cube`).
        kind: Class of object (`cube`, `tray`, `bottle`, `wall`, `table`).
        movable: Whether it can be moved at all; walls and tables cannot.
        pose: `world_T_entity` of its body frame.
        shapes: Its solids, in the entity frame.
        interior: Where objects can be put into it; absent when nothing can.
        datum_m: (3,) the point in its frame at which its world locates it [m]: it is inside by its centre and by this
            point, centred by this point, and on no object whose own is higher; absent where the centre alone counts.
        color: Colour word, empty when unknown; of an unnamed object as it is seen, `red or orange` where two may hold.
        rgb: (3,) that colour as it is seen, 0..1; absent for objects of the inventory.
        form: `box`, `can`, `ball` as it is seen, `box or can` where two may hold; empty for another, and for objects of
            the inventory.
        described: What its name stands for where a goal gave one to an unnamed object: `a red box`.
        visible: Whether it was seen at its pose, at `observed_at_s`; false for what is gone, and for what
            was moved while not visible.
        held_by: Name of the target whose gripper holds it: it is touched by both fingers, or perceived between fingers
            that press; absent when none does.
        speed_m_s: Magnitude of its linear velocity [m/s].
        still_since_s: Since when it was seen, or felt, in one place [s]; absent where nothing asks, as under truth.
        joint: Opening as a fraction 0..1 for objects with a joint (drawer, door), absent for others.
        mechanism: How it opens, for these objects.
        part_of: Name of the object that it is fixed to.
        contents: Balls in its interior; absent where it has none, and in a scene without balls.
        observed_at_s: Simulated or robot time of the observation [s]: that of the frames, not that of the question.
        confidence: 0..1.
        source: Sensor or pipeline of this fact.
        status: How it is known now.
        extent_m: (3,) size of what was seen of it, along its own axes [m]; absent when it was not measured.
        in_hand: `tcp_T_entity` while it is held.
        taken_at_m: (3,) where it was when the fingers closed on it, in the world [m]; absent when it is not held.
        looks: So many measurements its pose is the mean of; of a held object, so many looks have shown it in the hand
            since it was lifted.
        position_std_m: Standard deviation of its position as the measurement states [m]; 0 when not stated.
        size_std_m: The same of each side of the box that stands for an object of unknown form [m].
        turn_std_rad: The same of its orientation [rad], among those that look alike the one that was chosen.
        tilt_std_rad: The same of the angle of its z axis to the vertical [rad], over all that look alike.
        lean_rad: (3,) turn in the world from the stated orientation to the one that pixels alone give [rad]; an object
            is stated to be upright where they do not contradict it.
        evidence: Where it was seen: `camera@time_s:left,top,width,height`, in pixels.
        alternatives: Names that this body may have as well, and whose body may have this name: no look, no mark and no
            history tells them apart. Empty where the name is known.
        named_at_s: When the present naming among the alternatives was chosen [s]; it has followed the body since.
        bears: Of a hidden object, what is seen to stand on it, and on nothing else: that shows where it is.
    """

    name: str
    kind: str
    pose: Pose
    movable: bool = True
    shapes: tuple[Shape, ...] = ()
    interior: Interior | None = None
    datum_m: tuple[float, float, float] | None = None
    color: str = ""
    rgb: tuple[float, float, float] | None = None
    form: str = ""
    described: str = ""
    visible: bool = True
    held_by: str | None = None
    speed_m_s: float = 0.0
    still_since_s: float | None = None
    joint: float | None = None
    mechanism: Mechanism | None = None
    part_of: str = ""
    contents: Contents | None = None
    observed_at_s: float = 0.0
    confidence: float = 1.0
    source: str = ""
    status: Status = Status.SEEN
    extent_m: tuple[float, float, float] | None = None
    in_hand: Pose | None = None
    taken_at_m: tuple[float, float, float] | None = None
    looks: int = 0
    position_std_m: float = 0.0
    size_std_m: float = 0.0
    turn_std_rad: float = 0.0
    tilt_std_rad: float = 0.0
    lean_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    evidence: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    named_at_s: float = 0.0
    bears: str = ""

    @property
    def is_unsure(self) -> bool:
        """Whether a look found it, and so little fits that it may be elsewhere, or another object."""
        return self.status is Status.SEEN and not self.confidence >= SURE


class Region(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A named box of space, posed in the world, in which objects may be put (`shelf_board`, `left_half`).

    Attributes:
        name: Unique name.
        pose: `world_T_region` of its centre.
        half_m: (3,) half extents [m].
        alternatives: Regions that it may be exchanged with, as the two halves of a tray that looks the same turned
            half around; a name that no region has stands for its unnamed image.
    """

    name: str
    pose: Pose
    half_m: tuple[float, float, float]
    alternatives: tuple[str, ...] = ()


class TargetState(msgspec.Struct, frozen=True, kw_only=True):
    """The state that a target reports.

    Attributes:
        q_rad: (n_joints,) measured joint positions [rad].
        qd_rad_s: (n_joints,) measured joint velocities [rad/s].
        gripper_width_m: Opening between the fingers [m].
        tcp: `world_T_tcp`; z is the approach axis, y the closing axis.
        holding: Names of the entities that the gripper holds, as in `held_by`.
        fingers_touching: How many finger pads touch something, by touch sensors; 0 for a hand without such.
        grip_force_n: Force that presses the fingers together, by the current of their motor [N]; None where it is
            not measured.
        postures: Postures of its profile by name, (n_joints,) each [rad].
        q_std_rad: Standard deviation of each of `q_rad` as its profile states [rad]; 0 when not stated.
        base: Measured x, y [m] and heading [rad] of its base in the world; None where it is fixed.
        trunk: `world_T_body` of that base, by its own tilt and height as measured; None where it is fixed.
        inventory: What it carries, by kind of item, each at least 1; left out where it reports none of that.
        vitals: How well it is, by name (`health`, `food`), in its own scale; left out as the inventory.
        nearby: Kinds of the places in its reach at which something is made (`table`); left out as the inventory.
        daylight: How light it is where it is, 0..1; left out as the inventory.
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    gripper_width_m: float
    tcp: Pose
    holding: tuple[str, ...] = ()
    fingers_touching: int = 0
    grip_force_n: float | None = None
    postures: dict[str, tuple[float, ...]] = {}
    q_std_rad: float = 0.0
    base: tuple[float, float, float] | None = None
    trunk: Pose | None = None
    inventory: dict[str, int] | UnsetType = UNSET
    vitals: dict[str, float] | UnsetType = UNSET
    nearby: tuple[str, ...] | UnsetType = UNSET
    daylight: float | UnsetType = UNSET

    @property
    def is_gripping(self) -> bool:
        """Whether something is between the fingers: by the motor's current and the opening, or else by touch."""
        if self.grip_force_n is None:
            return self.fingers_touching >= 2
        return self.grip_force_n >= GRIP_N and self.gripper_width_m >= CLOSED_M


class Change(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What became of one object since the revision before.

    Attributes:
        entity: Its name.
        what: `appeared`, `moved`, `held`, `released`, `hidden`, `seen` (again), `gone`.
        by_m: How far it moved [m]; 0 where it did not.
    """

    entity: str
    what: str
    by_m: float = 0.0


LEAST_STD_M = 0.0003  # no look of any camera knows a position better
UNPROVEN = "unproven"  # status of a camera, see `SensorHealth`


class SensorHealth(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The state of one camera.

    Attributes:
        status: `live`, `stale` (its frames do not advance), `frozen` (new stamps, the same picture), `dark` (no depth
            at all), `displaced` (its depth disagrees with the map or with other cameras), `missing`, `unread` (no
            detector could read it), `unproven` (without noise and count, and no picture has differed from its first).
        time_s: Stamp of its latest frame [s].
        digest: Hash of its latest whole frame.
        shown_rad: (n_joints,) of the robot when it first gave that frame [rad]; empty where noise renews all frames.
        since_s: When it came to this status [s].
        detail: In words, or the target's own code.
        pose: `world_T_camera` that came with that frame, in OpenCV's convention.
        focal_px: (fx, fy, cx, cy) of the whole picture.
        size_px: (width, height) of the whole picture.
        liveness_probe: Hash of a small window of its latest frame, and the stamp of that: `hash@time_s`.
        probed_s: When that window was asked for [s].
        number: The sensor's own count at its latest frame; negative where it has none.
    """

    status: str = "live"
    time_s: float = 0.0
    digest: str = ""
    shown_rad: tuple[float, ...] = ()
    since_s: float = 0.0
    detail: str = ""
    pose: Pose | None = None
    focal_px: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    size_px: tuple[int, int] = (0, 0)
    liveness_probe: str = msgspec.field(default="", name="pulse")
    probed_s: float = msgspec.field(default=0.0, name="pulse_s")
    number: int = -1


class PriorKnowledge(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What perception knows of a world before its first look.

    Attributes:
        level: As perception.yaml names it.
        forms: Names of the objects whose forms and sizes it knows.
        colors: So many colours of surfaces by which it labels pixels.
        map: Names of the fixed bodies whose places it knows, up to their uncertainty.
        sides_m: Of the movable objects whose forms it knows: the sides of the box around each, the least first [m].
    """

    level: str
    forms: tuple[str, ...] = ()
    colors: int = 0
    map: tuple[str, ...] = ()
    sides_m: dict[str, tuple[float, float, float]] = {}


class Environment(msgspec.Struct, frozen=True, kw_only=True):
    """One snapshot of the world: the content of ENVIRONMENT.md.

    Attributes:
        time_s: Simulated or robot time of the snapshot [s].
        scene: Name of the scene.
        episode: The run of the scene this snapshot belongs to.
        revision: Grows with each published snapshot.
        sensing: `truth` (simulator state) or `perceived`.
        entities: By name.
        regions: By name.
        targets: By name.
        sensors: Cameras by name; empty where nothing is perceived.
        looked_at_s: Time of the latest look at everything [s]; 0 where nothing is perceived.
        changes: What became of objects since the revision before, the largest first.
        never_seen: Movable objects that the inventory names and no look has shown.
        prior: What perception knew before its first look; absent where nothing is perceived.
    """

    time_s: float
    scene: str
    episode: str
    revision: int
    sensing: str
    entities: dict[str, Entity]
    regions: dict[str, Region] = {}
    targets: dict[str, TargetState] = {}
    sensors: dict[str, SensorHealth] = {}
    looked_at_s: float = 0.0
    changes: tuple[Change, ...] = ()
    never_seen: tuple[str, ...] = ()
    prior: PriorKnowledge | None = None

    def list_movable(self) -> list[str]:
        """Names of all movable objects, also of those that no look has shown."""
        return [*(name for name, entity in self.entities.items() if entity.movable), *self.never_seen]

    def find_movable(self, names: Iterable[object]) -> str | None:
        """The first of these names, lists included, that is a movable object; None when none is."""
        flat = (name for each in names for name in (each if isinstance(each, list | tuple) else (each,)))
        objects = (name for name in flat if isinstance(name, str) and name in self.entities)
        return next((name for name in objects if self.entities[name].movable), None)

    def shows(self, name: str) -> bool:
        """Whether it shows where an object or a region is now, see `explain_unseen`."""
        entity = self.entities.get(name)
        return name in self.regions or (entity is not None and not self.explain_unseen(entity))

    def explain_motion(self, entity: Entity) -> str:
        """Why the snapshot does not show that an object rests; empty where it does, and for what is fixed or held."""
        if not entity.movable or entity.status is Status.HELD or entity.held_by:
            return ""
        if not entity.speed_m_s <= REST_M_S:
            return f"{entity.name} still moves at {entity.speed_m_s:.3f} m/s"
        since_s = entity.still_since_s
        if since_s is not None and entity.observed_at_s - since_s < REST_S:
            still_s = entity.observed_at_s - since_s
            return f"{entity.name} was seen in one place for {still_s:.2f} s, which does not show that it rests"
        return ""

    @property
    def sees(self) -> bool:
        """Whether a camera is believed, or there is none to be."""
        return not self.sensors or any(each.status in {"live", UNPROVEN} for each in self.sensors.values())

    def describe_cameras(self) -> str:
        """`left, right are frozen (a new stamp on the same picture)`; empty where all are live."""
        found: dict[str, list[str]] = {}
        for name, each in self.sensors.items():
            if each.status != "live":
                found.setdefault(f"{each.status}{f' ({each.detail})' if each.detail else ''}", []).append(name)
        verbs = ("is", "are")
        return "; ".join(f"{format_names(names)} {verbs[len(names) > 1]} {how}" for how, names in found.items())

    def explain_unseen(self, entity: Entity, max_age_s: float = FRESH_S) -> str:
        """Why the snapshot does not show where an object is now; empty where it does.

        The one rule of freshness. A fixed object cannot have changed, a held one is felt. Anything else was seen in the
        look of the snapshot: neither hidden nor gone, at most `FRESH_S` (or `max_age_s`) before it, and surely; or
        what it bears was.
        """
        if not entity.movable:
            return ""
        if (bearing := self.entities.get(entity.bears)) is not None and bearing.status is Status.SEEN:
            return self.explain_unseen(bearing, max_age_s)
        age_s, allowed_s = self.time_s - entity.observed_at_s, min(max_age_s, FRESH_S)
        if not entity.visible:
            return f"{entity.name} was not visible"
        if not age_s >= -AHEAD_S:  # also when it is NaN
            return f"{entity.name} is dated {-age_s:.1f} s after the snapshot"
        if not age_s <= allowed_s:
            blind = "" if self.sees else f": {self.describe_cameras()}"
            return f"{entity.name} was last seen {age_s:.1f} s before; up to {allowed_s:g} s is allowed{blind}"
        if entity.status not in {Status.SEEN, Status.HELD}:
            return f"{entity.name} was {entity.status} in this look, last seen {age_s:.1f} s before"
        if entity.is_unsure:
            return f"{entity.name} was seen with a confidence of {entity.confidence:.2f}, least is {SURE:g}"
        return ""


class Relation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One relation that is true in a snapshot.

    Attributes:
        name: `inside`, `on`, `holding`, `near`, `left_of`, `open`, `closed`.
        arguments: Names of the target, objects and places that it relates.
        measured: The numbers that decided; units in the names.
        observed_at_s: When the oldest of the movable objects was observed [s].
        source: Sensors or pipelines of these facts.
    """

    name: str
    arguments: tuple[str, ...]
    measured: dict[str, float | str | bool] = {}
    observed_at_s: float = 0.0
    source: str = ""

    @property
    def text(self) -> str:
        """As a predicate: `inside(red_cube, red_tray)`."""
        return f"{self.name}({', '.join(self.arguments)})"


class Snapshot(Environment, frozen=True, kw_only=True):
    """The block of ENVIRONMENT.md: a snapshot, and what follows from it.

    Attributes:
        relations: What is true in it, by the same rules as verdicts; at most 200, places before neighbours.
    """

    relations: tuple[Relation, ...] = ()


ENVIRONMENT = DocumentFormat(
    name="environment",
    file="ENVIRONMENT.md",
    summary="The world as last observed: objects, regions, targets, and the relations between them.",
    block=Snapshot,
    headings=("Snapshot",),
)


def read_environment(text: str, source: str = "") -> Snapshot:
    """Read ENVIRONMENT.md; raises DefinitionError: every problem at file:line:column, `NOT_OBSERVED` when empty."""
    blocks = read_document(text, ENVIRONMENT, source).blocks
    if "Snapshot" not in blocks:
        address, found = f"{source or ENVIRONMENT.file}:1:1", "no block of YAML below '## Snapshot'"
        hint = "The worker of a target writes one at the end of its first session."
        raise DefinitionError.of("NOT_OBSERVED", address, found, hint=hint)
    return blocks["Snapshot"]
