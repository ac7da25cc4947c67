"""All that a request can be about: objects and regions of the scene, what skills bring about, postures, past goals.

Upstream: the catalogue and its scene file. Downstream: the understanders. Every noun comes from here.
"""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from pathlib import Path

import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.selector import ANY, find_lacks
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.errors import DefinitionError
from phyagentos.geometry import Vector
from phyagentos.protocol.capabilities.targets import is_beside
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.predicates import syntax
from phyagentos.protocol.predicates.meaning import normalize
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.predicates.relations import find_places
from phyagentos.protocol.predicates.view import View
from phyagentos.protocol.world.descriptions import COLORS
from phyagentos.protocol.world.entity_geometry import AXES, compute_center, compute_extent
from phyagentos.protocol.world.environment import UNNAMED, Environment
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene
from phyagentos.protocol.world.truth import Truth

REGION = "region"
ROLE = "robot"  # of the target in goals of requests
FRAME_M = 0.35  # how far the middle of a lid, a door or a drawer is from that of its frame at most
LOOSE = "ball"  # one of the nameless contents of a vessel
WORD = re.compile(r"[a-z][a-z0-9 '-]*")  # what of the text of a scene is taken for a word
NO_TOPS = {
    "table",
    "floor",
    "wall",
    REGION,
    "cabinet",
    "panel",
    "stand",
}  # kinds onto which no request puts an object by itself
SURFACES = ("table", "floor")  # kinds on which objects stand that the scene places nowhere else


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneObject:
    """A listed body or a region, as requests can name it; what it does not have is empty.

    Attributes:
        kind: Class of object; `REGION` for a space rather than a body.
        words: Words that may stand before its noun: of its name, its colour, its material, and of what it is part of.
        heads: Nouns that mean it: its kind, and the last word of its name.
        opens: `slide` or `hinge`.
        part_of: The object that it is fixed to, or whose lid, door or drawer it is.
        stands: The object in or on which the scene places it at first; `ground` is the table or the floor under it.
        contents: Number of loose balls in it.
        at_m: (3,) its middle in the world [m], `half_m` (3,) half of the box around it; None where no world is known.
    """

    name: str
    kind: str
    colour: str = ""
    words: frozenset[str] = frozenset()
    heads: frozenset[str] = frozenset()
    movable: bool = False
    has_interior: bool = False
    opens: str = ""
    part_of: str = ""
    stands: str = ""
    ground: str = ""
    contents: int = 0
    at_m: Vector | None = None
    half_m: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vocabulary:
    """What a request over one scene can be about.

    Attributes:
        capabilities: Predicates that some skill guarantees on some target, negated ones as `not inside`.
        robot: The target that goals of requests are for.
        unlisted: Colour and form of each object that is seen and in no inventory: no goal can be about it.
        past: Goals of the scene that were asked for before, the latest last.
        world: The scene as it begins; without it no statement is known to be true or false.
    """

    scene: str
    objects: Mapping[str, SceneObject]
    capabilities: tuple[str, ...]
    targets: tuple[str, ...]
    robot: str = ANY
    postures: tuple[str, ...] = ()
    past: tuple[WantedGoal, ...] = ()
    unlisted: tuple[tuple[str, str], ...] = ()
    world: Environment | None = field(default=None, compare=False, repr=False)

    @classmethod
    def read(
        cls,
        catalogue: Catalogue,
        scene: str,
        past: Iterable[WantedGoal] = (),
        robot: str = ANY,
        world: Environment | None = None,
    ) -> "Vocabulary":
        """The vocabulary of a scene; raises DefinitionError where that is unknown or cannot be read.

        Where objects are, and how large, is that of `world`; without one no phrase is decided by that.
        """
        if scene not in catalogue.scenes:
            raise DefinitionError.unknown("scene", "--scene", scene, catalogue.scenes)
        spec = read_scene(catalogue.scenes[scene])
        bodies = {name: body for name, body in spec.bodies.items() if body.listed}
        objects = {name: _read_object(spec, name, body) for name, body in bodies.items()}
        for name, region in spec.regions.items():
            words = frozenset((*name.split("_"), *(region.body or "").split("_"))) - {""}
            objects[name] = SceneObject(name=name, kind=REGION, words=words, heads=_find_heads(name), has_interior=True)
        postures = (each for _, profile in sorted(catalogue.targets.items()) for each in profile.postures)
        seen = world.entities.values() if world is not None else ()
        unlisted = tuple((each.color, each.form) for each in seen if each.kind == UNNAMED)
        located = _locate(objects, world) if world is not None else objects
        return cls(
            scene=scene,
            objects=_add_synonyms(located, {form for _, form in unlisted}),
            unlisted=unlisted,
            capabilities=_find_capabilities(catalogue),
            targets=tuple(sorted(catalogue.targets)),
            robot=robot,
            postures=tuple(dict.fromkeys(postures)),
            past=tuple(goal for goal in past if goal.scene == scene),
            world=world,
        )

    def is_known(self, text: str, *, is_true: bool) -> bool:
        """Whether a statement is known to be true, or to be false, as the scene begins."""
        if self.world is None:
            return False
        truth = parse_predicate(text).evaluate(View(now=self.world, initial=self.world, target=self.robot)).truth
        return truth is (Truth.TRUE if is_true else Truth.FALSE)

    def is_unlisted(self, head: str, adjectives: Iterable[str]) -> bool:
        """Whether words mean an object that is seen and in no inventory."""
        others = {form: {form, *read_lexicon()["synonyms"].get(form, ())} for _, form in self.unlisted}
        return any(
            (not head or head in others[form]) and {*adjectives} <= {*colour.split()} and (head or adjectives)
            for colour, form in self.unlisted
        )

    def list_words(self) -> tuple[frozenset[str], frozenset[str]]:
        """Words that may stand before a noun, and nouns; colours stand for nouns, too."""
        objects = self.objects.values()
        adjectives = {*COLORS}.union(*(item.words for item in objects))
        nouns = {LOOSE for item in objects if item.contents}.union(*(item.heads for item in objects))
        for noun in ({form for _, form in self.unlisted} | (nouns & {LOOSE})) - {""}:
            nouns |= {noun, *read_lexicon()["synonyms"].get(noun, ())}
        return frozenset(filter(WORD.fullmatch, adjectives)), frozenset(filter(WORD.fullmatch, nouns))


def _locate(objects: Mapping[str, SceneObject], world: Environment) -> dict[str, SceneObject]:
    """The objects with their places and sizes."""
    located = dict(objects)
    for name in objects.keys() & world.entities.keys():
        entity = world.entities[name]
        x_m, y_m, z_m = ((high - low) / 2 for low, high in (compute_extent(entity, axis) for axis in AXES))
        below = [each.arguments[-1] for each in find_places(entity, world) if each.arguments[-1] in objects]
        owners = [each for each in below if objects[each].kind not in (*SURFACES, REGION)]
        stands, ground = objects[name].stands, next((each for each in below if objects[each].kind in SURFACES), "")
        is_high = bool(stands) and objects[stands].kind not in SURFACES
        located[name] = replace(
            objects[name],
            stands=stands if is_high else next(iter(owners), ""),
            ground=ground,
            at_m=compute_center(entity),
            half_m=(x_m, y_m, z_m),
        )
    for name, region in world.regions.items():
        located |= (
            {name: replace(objects[name], at_m=region.pose.position_m, half_m=region.half_m)} if name in objects else {}
        )
    return located


def _add_synonyms(objects: Mapping[str, SceneObject], taken: Set[str]) -> dict[str, SceneObject]:
    """The objects with further nouns for them, as far as nothing else here is called so."""
    taken = {head for item in objects.values() for head in item.heads} | taken
    more = {noun: {*others} - taken for noun, others in read_lexicon()["synonyms"].items()}
    return {
        name: replace(item, heads=item.heads.union(*(more.get(head, ()) for head in item.heads)))
        for name, item in objects.items()
    }


@lru_cache(maxsize=1)
def read_lexicon() -> Fields:
    """The words of requests, as written."""
    return dict(yaml.safe_load((Path(__file__).parent / "lexicon.yaml").read_text(encoding="utf-8")))


def find_robot(catalogue: Catalogue, graphs: Iterable[Path], scene: str) -> str:
    """The target that goal graphs of a scene name most; else one whose model is beside its profile, or `any`."""
    named: Counter[str] = Counter()
    for path in graphs:
        with suppress(DefinitionError):
            data = read_yaml(path).data
            if isinstance(data, dict) and data.get("scene") == scene and isinstance(data.get("targets"), dict):
                named.update(name for name in data["targets"].values() if name in catalogue.targets)
    beside = sorted(name for name, profile in catalogue.targets.items() if is_beside(profile.model))
    return next((name for name, _ in named.most_common(1)), beside[0] if beside else ANY)


def _find_heads(name: str) -> frozenset[str]:
    """The nouns in a name: its last word, and with it the one before where it is a number (`ball 1`)."""
    *before, last = name.lower().split("_")
    return frozenset({" ".join((*before[-1:], last)) if last.isdigit() else last})


def _read_object(spec: SceneSpec, name: str, body: Body) -> SceneObject:
    part_of = body.part_of or (_find_frame(spec, name) if body.joint else "")
    of = (*part_of.split("_"), spec.bodies[part_of].kind) if part_of else ()
    words = {*name.lower().split("_"), *body.color.split(), *(body.material or "").split("_"), *of}
    return SceneObject(
        name=name,
        kind=body.kind,
        colour=body.color,
        words=frozenset(words - {""}),
        heads=_find_heads(name) | {body.kind.lower().replace("_", " ")},
        movable=not (body.fixed or body.joint or body.part_of),
        has_interior=body.interior is not None,
        opens=body.joint.kind if body.joint else "",
        part_of=part_of,
        stands=body.place.frame or "",
        contents=body.contents.count if body.contents else 0,
    )


def _find_frame(spec: SceneSpec, name: str) -> str:
    """The fixed object that one with a joint is a part of: the nearest, as a scene does not say; or empty."""
    at = _find_position(spec, name)
    fixed = (other for other, body in spec.bodies.items() if body.fixed and body.kind not in SURFACES)
    apart_m = {other: math.dist(at, _find_position(spec, other)) for other in fixed}
    return min((other for other in apart_m if apart_m[other] <= FRAME_M), key=apart_m.__getitem__, default="")


def _find_position(spec: SceneSpec, name: str) -> tuple[float, ...]:
    """Where a body is placed, without jitter and turns [m]."""
    place = spec.bodies[name].place
    base = _find_position(spec, place.frame) if place.frame else (0.0, 0.0, 0.0)
    return tuple(a + b for a, b in zip(base, place.position_m, strict=True))


def _find_capabilities(catalogue: Catalogue) -> tuple[str, ...]:
    targets = catalogue.targets.values()
    able = (skill for skill in catalogue.skills.values() if not all(any(find_lacks(skill, each)) for each in targets))
    formulas = (parse_predicate(text, template=True).formula for skill in able for text in skill.guarantees)
    literals = (literal for formula in formulas for literal in iter_literals(formula))
    named = ((is_true, normalize(call).name) for is_true, call in literals)
    return tuple(sorted({name if is_true else f"not {name}" for is_true, name in named}))


def iter_literals(formula: syntax.Formula, *, is_true: bool = True) -> Iterator[tuple[bool, syntax.Call]]:
    """Each predicate in a formula with whether it is to be true; the parts of a disjunction count each."""
    match formula:
        case syntax.Call():
            yield is_true, formula
        case syntax.Not(body):
            yield from iter_literals(body, is_true=not is_true)
        case syntax.And(parts) | syntax.Or(parts):
            yield from chain.from_iterable(iter_literals(part, is_true=is_true) for part in parts)
        case syntax.Count(body):
            yield from iter_literals(body, is_true=is_true)
        case syntax.Compare(left, relation, _):
            yield from iter_literals(left, is_true=is_true is (relation not in {"<", "<="}))
