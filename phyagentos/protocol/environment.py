"""What is in the world, as the planes share it: entities, relations, targets; ENVIRONMENT.md is its document.

Upstream: the runtime's perception. Downstream: predicates, planning scenes, the verifier. Poses are in the frame
`world` (z up, metres, quaternions w x y z) unless a name says otherwise. Paper section 4.1.
"""

from enum import StrEnum

import msgspec

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.document import DocumentFormat, read_document


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


class Pose(msgspec.Struct, frozen=True):
    """A rigid pose `parent_T_child`.

    Attributes:
        position_m: (3,) [m].
        quaternion_wxyz: (4,) unit quaternion.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


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


class Entity(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A thing in the world, as believed at `observed_at_s`.

    Attributes:
        name: Unique name (`red_cube`).
        kind: Class of thing (`cube`, `tray`, `bottle`, `wall`, `table`).
        movable: Whether it can be moved at all; walls and tables cannot.
        pose: `world_T_entity` of its body frame.
        shapes: Its solids, in the entity frame.
        interior: Where things can be put into it; absent when nothing can.
        color: Colour word, empty when unknown.
        visible: Whether it was seen at `observed_at_s`.
        held_by: Name of the target whose gripper touches it with both fingers, absent when nobody's.
        speed_m_s: Magnitude of its linear velocity [m/s].
        joint: Opening as a fraction 0..1 for things with a joint (drawer, door), absent for others.
        observed_at_s: Simulated or robot time of the observation [s].
        confidence: 0..1.
        source: Which sensor or pipeline said so.
    """

    name: str
    kind: str
    pose: Pose
    movable: bool = True
    shapes: tuple[Shape, ...] = ()
    interior: Interior | None = None
    color: str = ""
    visible: bool = True
    held_by: str | None = None
    speed_m_s: float = 0.0
    joint: float | None = None
    observed_at_s: float = 0.0
    confidence: float = 1.0
    source: str = ""


class Region(msgspec.Struct, frozen=True, kw_only=True):
    """A named box of space, posed in the world, in which things may be put (`shelf_board`, `left_half`).

    Attributes:
        name: Unique name.
        pose: `world_T_region` of its centre.
        half_m: (3,) half extents [m].
    """

    name: str
    pose: Pose
    half_m: tuple[float, float, float]


class TargetState(msgspec.Struct, frozen=True, kw_only=True):
    """What a target says of itself.

    Attributes:
        q_rad: (n_joints,) measured joint positions [rad].
        qd_rad_s: (n_joints,) measured joint velocities [rad/s].
        gripper_width_m: Opening between the fingers [m].
        tcp: `world_T_tcp`; z is the approach axis, y the closing axis.
        holding: Names of the entities touched by both fingers.
    """

    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    gripper_width_m: float
    tcp: Pose
    holding: tuple[str, ...] = ()


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
    """

    time_s: float
    scene: str
    episode: str
    revision: int
    sensing: str
    entities: dict[str, Entity]
    regions: dict[str, Region] = {}
    targets: dict[str, TargetState] = {}


class Snapshot(Environment, frozen=True, kw_only=True):
    """The block of ENVIRONMENT.md: a snapshot, and what follows from it.

    Attributes:
        relations: Predicates that are true in it (`inside(red_cube, red_tray)`), by the same rules as verdicts.
    """

    relations: tuple[str, ...] = ()


ENVIRONMENT = DocumentFormat(
    name="environment",
    file="ENVIRONMENT.md",
    says="The world as last observed: things, regions, targets, and the relations between them.",
    block=Snapshot,
    headings=("Snapshot",),
)


def read_environment(text: str, source: str = "") -> Snapshot:
    """Read ENVIRONMENT.md.

    Raises:
        DefinitionError: With every problem, each at file:line:column; `NOTHING_OBSERVED` when it holds no snapshot.
    """
    blocks = read_document(text, ENVIRONMENT, source).blocks
    if "Snapshot" not in blocks:
        raise DefinitionError(
            Problem(
                code="NOTHING_OBSERVED",
                address=f"{source or ENVIRONMENT.file}:1:1",
                found="no block of YAML below '## Snapshot'",
                hint="The worker of a target writes one at the end of its first session.",
            )
        )
    return blocks["Snapshot"]
