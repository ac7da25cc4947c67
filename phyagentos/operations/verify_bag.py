"""Verdicts over what others executed: criteria judged on a recorded bag of ROS 2, perceived as frames of a session are.

The robot need not know this project; it needs a profile (`paos robot new`), by which it is masked in pictures.
"""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from phyagentos.agent.judging.judges.judge_registry import make_unknown
from phyagentos.agent.judging.judges.predicates import evaluate_on
from phyagentos.assembly.project import open_library
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import name_placed, read_placed
from phyagentos.protocol.documents.durable_files import require_empty
from phyagentos.protocol.predicates.library import ArgumentKind
from phyagentos.protocol.predicates.predicate import has_metric, parse_predicate
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, write_json
from phyagentos.protocol.sessions.looks import LOOKS, LookEntry, LookRole
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.settings.bag import BagSettings, read_bag_settings
from phyagentos.protocol.world.environment import SURE
from phyagentos.protocol.world.truth import Truth

if TYPE_CHECKING:
    from phyagentos.runtime.perception.bag_reader import Bag
    from phyagentos.runtime.perception.perceived_bag import PerceivedBag

VERDICT = "verdict.json"


class ShownFrame(msgspec.Struct, frozen=True, kw_only=True):
    """A frame that was perceived: its camera, its stamp [ns], and the topics of its picture and its depth."""

    camera: str
    stamp_ns: int
    color: str
    depth: str


class ShownLook(msgspec.Struct, frozen=True, kw_only=True):
    """One look at the world of a bag.

    Attributes:
        role: `start`; `look`, before the end; `end`, on which the verdict rests.
        time_s: After the first joint state of the bag [s].
        file: Of the folder with the evidence; its pictures are there as `<role>-<camera>.png`, too.
    """

    role: LookRole
    time_s: float
    file: str
    frames: tuple[ShownFrame, ...]


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
) -> BagVerdict:
    """Judge what a bag shows at its end, and write looks, pictures and the verdict into a folder.

    Topics and frames are found where `settings` does not name them. The robot is the only one whose joints the bag has,
    where none is named.

    Raises:
        DefinitionError: `UNKNOWN_NAME`, `INVALID_VALUE`, `MISSING_VALUE`, `EXTRA_MISSING`, `WOULD_OVERWRITE`;
            `UNREADABLE_FILE` for the bag.
    """
    library, how = open_library(), read_bag_settings(settings) if settings is not None else BagSettings()
    require_empty(to)
    spec = read_placed(library, scene)
    _check_criteria(accept, sorted({*spec.bodies, *spec.regions}))
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.perception.bag_reader import read_bag
    from phyagentos.runtime.perception.perceived_bag import PerceivedBag

    recorded = read_bag(bag)
    named = {how.joint_states, *chain(*((each.color, each.depth, each.info) for each in how.cameras.values()))} - {""}
    if unknown := sorted(named - recorded.types.keys()):
        raise DefinitionError([Problem.unknown("topic", str(bag), each, recorded.types) for each in unknown])
    profile, folder = read_profile(library.get_target(robot or find_robot(library, recorded, how)))
    if profile.base is not None:
        raise DefinitionError.of("INVALID_VALUE", "--robot", f"{profile.target}, whose base moves", "one that stands")
    place = Scene(name=name_placed(scene, [profile]), seed=0, episode=bag.name)
    found = PerceivedBag(recorded, how, place, library, profile, folder)
    criteria = tuple(_judge(text, found, profile.target) for text in accept)
    truths = {each.truth for each in criteria}
    verdict = BagVerdict(
        bag=bag,
        scene=place.name,
        robot=profile.target,
        verdict=next((each for each in (Truth.FALSE, Truth.UNKNOWN) if each in truths), Truth.TRUE),
        criteria=criteria,
        looks=_write_looks(found, to),
        left_out=found.left_out,
        evidence=to,
    )
    write_json(to / VERDICT, msgspec.to_builtins(verdict, enc_hook=str))
    return verdict


def _check_criteria(accept: Sequence[str], known: Sequence[str]) -> None:
    """Raise DefinitionError with every criterion that no bag of this scene could decide."""
    problems = [] if accept else [Problem("MISSING_VALUE", "--accept", "no criterion", "at least one")]
    expected = "a criterion on the world, not on a metric"
    problems += [Problem("INVALID_VALUE", "--accept", text, expected) for text in accept if has_metric(text)]
    named = [each for text in accept for each in parse_predicate(text, address="--accept").iter_references()]
    others = [each.name for each in named if each.name not in known and each.kind is not ArgumentKind.TARGET]
    problems += [Problem.unknown("object", "--accept", name, known) for name in others]
    if problems:
        raise DefinitionError(problems)


def find_robot(library: Library, bag: "Bag", how: BagSettings) -> str:
    """The only robot that has all its joints, the gripper's included, in the bag; raises `MISSING_VALUE`."""
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.perception.bag_looks import find_joint

    profiles = [read_profile(library.get_target(name))[0] for name in library.names_of_targets()]
    joints = {each.target: (*each.arm.joints, *each.gripper.joints) for each in profiles}
    fitting = [name for name, each in joints.items() if all(find_joint(bag, how, joint) is not None for joint in each)]
    if len(fitting) != 1:
        found = f"the joints of {', '.join(fitting)}" if fitting else "joints of no robot of the library"
        hint = "Name it; `paos robot new FILE.urdf` makes a profile, and `joints:` of --settings maps other names."
        raise DefinitionError.of("MISSING_VALUE", "--robot", found, "a robot of `paos robot list`", hint)
    return fitting[0]


def _judge(text: str, found: "PerceivedBag", target: str) -> Criterion:
    """One criterion; unknown where the end of the bag, or how its cameras stand to the scene, is not seen."""
    if not found.seen or all(each.status != "live" for each in found.seen[-1][1].sensors.values()):
        return make_unknown(text, "accept", "", "; ".join(found.left_out))
    now, initial = found.seen[-1][1], found.seen[0][1] if len(found.seen) > 1 else None
    names = {each.name for each in parse_predicate(text).iter_references()}
    named = [each for name, each in now.entities.items() if name in names]
    placed = [each for each in now.entities.values() if not each.movable and each.looks]
    unsure = [each for each in placed if not each.confidence >= SURE]
    astray = [each for each in unsure if each in named] or (unsure if len(unsure) == len(placed) else [])
    fingers = "is between the fingers, and joint states do not tell whether it is held"
    once = "was seen once, which does not show that it rests"
    uncertainties = [
        *(f"{each.name} {fingers}" for each in named if each.name == found.between_fingers),
        *(f"{each.name} {once}" for each in named if each.movable and each.still_since_s is None),
        *(
            f"{each.name} does not show where the scene lets it be (it fits with a confidence of {each.confidence:.2f},"
            f" least is {SURE:g}): are frame and scene the bag's?"
            for each in astray
        ),
    ]
    if uncertainties:
        return make_unknown(text, "accept", AFTER, uncertainties[0])
    return evaluate_on(text, "accept", View(now=now, initial=initial, target=target), AFTER)


def _write_looks(found: "PerceivedBag", to: Path) -> tuple[ShownLook, ...]:
    """Looks, pictures and snapshots, under the names that they have in a session's bundle."""
    from phyagentos.runtime.perception.look_file import encode_pictures, write_look

    to.mkdir(parents=True, exist_ok=True)
    entries, shown = [], []
    roles = (LookRole.START, LookRole.LOOK, LookRole.END)[-len(found.seen) :]
    for role, (look, world) in zip(roles, found.seen, strict=False):
        file, sha256 = write_look(look, to)
        entries.append(LookEntry(file=file, sha256=sha256, role=role, time_s=look.now[0]))
        frames = tuple(
            ShownFrame(
                camera=each.camera,
                stamp_ns=found.looks.origin_ns + round(each.time_s * 1e9),
                color=found.looks.cameras[each.camera].color,
                depth=found.looks.cameras[each.camera].depth,
            )
            for each in look.captures[0][1].frames
        )
        shown.append(ShownLook(role=role, time_s=look.now[0], file=file, frames=frames))
        for camera, png in encode_pictures(look).items():
            (to / f"{role}-{camera}.png").write_bytes(png)
        write_json(to / {LookRole.START: BEFORE, LookRole.END: AFTER}.get(role, f"environment_{role}.json"), world)
    write_json(to / LOOKS, entries)
    return tuple(shown)
