"""Verdicts over what others executed: criteria judged on a recorded bag of ROS 2, perceived as frames of a session are.

The robot need not know this project; it needs a profile (`paos robot new`), by which it is masked in pictures.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.agent.judging.judges.predicates import evaluate_criterion
from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, read_placed
from phyagentos.protocol.documents.durable_files import require_empty
from phyagentos.protocol.predicates.library import ArgumentKind
from phyagentos.protocol.predicates.predicate import find_things, has_metric, parse_predicate
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, Bundle, write_json
from phyagentos.protocol.sessions.looks import LOOKS, LookEntry, LookRole
from phyagentos.protocol.sessions.session import Ended, Execution, GoalId, Scene, Session, SessionId
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.bag import BagCamera, BagSettings, read_bag_settings
from phyagentos.protocol.world.environment import SURE
from phyagentos.protocol.world.truth import Truth

if TYPE_CHECKING:
    from phyagentos.protocol.capabilities.targets import TargetProfile
    from phyagentos.runtime.perception.bag_reader import Bag
    from phyagentos.runtime.perception.perceived_bag import PerceivedBag, Seen

VERDICT = "verdict.json"
_EPISODE = "bag"


class ShownLook(msgspec.Struct, frozen=True, kw_only=True):
    """One look at the world of a bag.

    Attributes:
        role: `start`; `look`, shortly before the end; `end`, on which the verdict rests.
        time_s: After the first joint state of the bag [s].
        file: Of the folder with the evidence.
        frames: `camera: topic of the picture and of the depth, stamp [ns]`.
    """

    role: LookRole
    time_s: float
    file: str
    frames: tuple["ShownPicture", ...]


class ShownPicture(msgspec.Struct, frozen=True, kw_only=True):
    """One frame that was perceived: its camera, topics, stamp [ns], and the picture in the folder with the evidence."""

    camera: str
    stamp_ns: int
    color: str
    depth: str
    picture: str


class BagVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """A judgement of a bag.

    Attributes:
        verdict: True where every criterion is, false where one is, else unknown.
        criteria: In their order.
        looks: What it rests on, in the order of time; empty where nothing was seen.
        left_out: Topics, cameras and clocks that were not used, with the reason.
        evidence: Folder that was written.
    """

    bag: Path
    scene: str
    robot: str
    verdict: Truth
    criteria: tuple[Criterion, ...]
    looks: tuple[ShownLook, ...]
    left_out: tuple[str, ...]
    evidence: Path


def verify_bag(
    bag: Path,
    scene: str,
    accept: Sequence[str],
    to: Path,
    *,
    robot: str = "",
    settings: Path | None = None,
    topics: Sequence[str] = (),
) -> BagVerdict:
    """Judge what a bag shows at its end, and write looks, pictures and the verdict into a folder.

    `topics` are `camera=/topic` each; without, and without `settings`, all cameras of the bag are used. The robot is
    the only one whose joints the bag has, where none is named.

    Raises:
        DefinitionError: `UNKNOWN_NAME`, `INVALID_VALUE`, `MISSING_VALUE`, `EXTRA_MISSING`, `WOULD_OVERWRITE`;
            `UNREADABLE_FILE` for the bag.
    """
    library, how = open_library(), _choose_settings(settings, topics)
    require_empty(to)
    spec = read_placed(library, scene)
    _check_criteria(accept, {*spec.bodies, *spec.regions})
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.perception.bag_reader import read_bag
    from phyagentos.runtime.perception.perceived_bag import perceive_bag

    recorded = read_bag(bag)
    _check_topics(recorded, how)
    profile, folder = read_profile(library.get_target(robot or _find_robot(library, recorded, how)))
    if profile.base is not None:
        expected = "a robot whose base stands"
        raise DefinitionError.of("INVALID_VALUE", "--robot", f"{profile.target}, whose base moves", expected)
    place = Scene(name=name_placed(scene, [profile]), seed=0, episode=_EPISODE)
    found = perceive_bag(recorded, how, place, library, (profile, folder))
    to.mkdir(parents=True, exist_ok=True)
    criteria = tuple(_judge(text, found, _make_bundle(place, profile.target, accept, found, to)) for text in accept)
    truths = {each.truth for each in criteria}
    verdict = BagVerdict(
        bag=bag,
        scene=place.name,
        robot=profile.target,
        verdict=Truth.FALSE if Truth.FALSE in truths else Truth.UNKNOWN if Truth.UNKNOWN in truths else Truth.TRUE,
        criteria=criteria,
        looks=_write_looks(found.seen, to),
        left_out=found.left_out,
        evidence=to,
    )
    write_json(to / VERDICT, msgspec.to_builtins(verdict, enc_hook=str))
    return verdict


def _choose_settings(path: Path | None, topics: Sequence[str]) -> BagSettings:
    how = read_bag_settings(path) if path is not None else BagSettings()
    named = dict(text.partition("=")[::2] for text in topics)
    if wrong := next((name or topic for name, topic in named.items() if not name or not topic), ""):
        raise DefinitionError.of("INVALID_VALUE", "--topic", wrong, "CAMERA=/topic/of/its/pictures")
    cameras = {name: how.cameras.get(name, BagCamera(color=topic)) for name, topic in named.items()}
    given = {name: each.model_copy(update={"color": named[name]}) for name, each in cameras.items()}
    return how.model_copy(update={"cameras": how.cameras | given})


def _check_criteria(accept: Sequence[str], known: set[str]) -> None:
    """Raise DefinitionError with every criterion that no bag of this scene could decide."""
    problems = [] if accept else [Problem("MISSING_VALUE", "--accept", "no criterion", "at least one")]
    for text in accept:
        if has_metric(text):
            problems.append(Problem("INVALID_VALUE", "--accept", text, "a criterion on the world, not on a metric"))
        named = parse_predicate(text, address="--accept").iter_references()
        others = (each.name for each in named if each.name not in known and each.kind is not ArgumentKind.TARGET)
        problems += [Problem.unknown("object", "--accept", name, sorted(known)) for name in others]
    if problems:
        raise DefinitionError(problems)


def _check_topics(bag: "Bag", how: BagSettings) -> None:
    named = [topic for each in how.cameras.values() for topic in (each.color, each.depth, each.info) if topic]
    named += [how.joint_states] if how.joint_states else []
    problems = [Problem.unknown("topic", "the bag", each, bag.types) for each in named if each not in bag.types]
    if problems:
        raise DefinitionError(problems)


def _find_robot(library: Library, bag: "Bag", how: BagSettings) -> str:
    """The only robot that has all its joints, the gripper's included, in the bag; raises `MISSING_VALUE`."""
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.perception.bag_frames import find_joint

    def has_all(profile: "TargetProfile") -> bool:
        names = (*profile.arm.joints, *profile.gripper.joints)
        return bool(names) and all(find_joint(bag, how, name) is not None for name in names)

    profiles = (read_profile(library.get_target(name))[0] for name in library.names_of_targets())
    fitting = [each.target for each in profiles if has_all(each)]
    if len(fitting) != 1:
        found = f"the joints of {', '.join(fitting)}" if fitting else "joints of no robot of the library"
        hint = "Name it; `paos robot new FILE.urdf` makes a profile, and `joints:` of --settings maps other names."
        raise DefinitionError.of("MISSING_VALUE", "--robot", found, "a robot of `paos robot list`", hint)
    return fitting[0]


def _make_bundle(scene: Scene, target: str, accept: Sequence[str], found: "PerceivedBag", folder: Path) -> Bundle:
    """What a session would have left that showed the same."""
    session = Session(
        id=SessionId(_EPISODE),
        goal=GoalId(""),
        node="",
        objective="",
        skill="",
        target=target,
        parameters={},
        accept=tuple(accept),
        scene=scene,
        seed=0,
    )
    worlds = [each.world for each in found.seen]
    return Bundle(
        folder=folder,
        session=session,
        execution=Execution(ended=Ended.COMPLETED, evidence=""),
        before=worlds[0] if len(worlds) > 1 else None,
        after=worlds[-1] if worlds else None,
        holds=(),
        trace=(),
        events=(),
    )


def _judge(text: str, found: "PerceivedBag", bundle: Bundle) -> Criterion:
    """One criterion; unknown where the end of the bag, or how its cameras stand to the scene, is not seen."""
    after = bundle.after
    if after is None:
        return make_unknown(text, "accept", "", "; ".join(found.left_out) or "the bag shows no picture at its end")
    if found.between_fingers and found.between_fingers in find_things(text, after):
        why = f"{found.between_fingers} is between the fingers, and joint states do not tell whether it is held"
        return make_unknown(text, "accept", AFTER, why)
    names = {each.name for each in parse_predicate(text).iter_references()}
    placed = [each for each in after.entities.values() if not each.movable and each.looks]
    unsure = [each for each in placed if not each.confidence >= SURE]
    if astray := [each for each in unsure if each.name in names or len(unsure) == len(placed)]:
        least = min(astray, key=lambda each: each.confidence)
        why = f"{least.name} does not fit where the scene lets it be, with a confidence of {least.confidence:.2f}"
        return make_unknown(text, "accept", AFTER, f"{why}, least is {SURE:g}: are frame and scene those of the bag?")
    return evaluate_criterion(text, "accept", bundle)


def _write_looks(seen: Sequence["Seen"], to: Path) -> tuple[ShownLook, ...]:
    """Looks, pictures and snapshots, under the names that they have in a session's bundle."""
    from phyagentos.runtime.perception.look_file import encode_pictures, write_look

    roles = {len(seen) - 1: LookRole.END} | ({0: LookRole.START} if len(seen) > 1 else {})
    entries, shown = [], []
    for index, each in enumerate(seen):
        role, pictures = roles.get(index, LookRole.LOOK), {}
        for camera, png in encode_pictures(each.look).items():
            pictures[camera] = f"{role}-{camera}.png".replace("/", "_")
            (to / pictures[camera]).write_bytes(png)
        file, sha256 = write_look(each.look, to)
        entries.append(LookEntry(file=file, sha256=sha256, role=role, time_s=each.moment.time_s))
        frames = tuple(
            ShownPicture(
                camera=frame.camera,
                stamp_ns=frame.stamp_ns,
                color=frame.color,
                depth=frame.depth,
                picture=pictures[frame.camera],
            )
            for frame in each.moment.shown
        )
        shown.append(ShownLook(role=role, time_s=each.moment.time_s, file=file, frames=frames))
        if role is not LookRole.LOOK:
            write_json(to / (BEFORE if role is LookRole.START else AFTER), each.world)
    write_json(to / LOOKS, entries)
    return tuple(shown)
